"""Plots of an identification: curve, residual orders, elements, shares."""

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import rvjax
from rvjax.commands.identify.identified import Band, Identified
from rvjax.commands.identify.words import elements, field_of
from rvjax.identify import mapped_values
from rvjax.measured import judge
from rvjax.render import Figure
from rvjax.study import Loop, Run, orders_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RUNS = 4  # curves that are plotted
SIDES = np.array([-1.959964, 1.959964])  # of a 95 % interval


def figures(found: Identified) -> Iterator[Figure]:
    """The plots of an identification; none of a check or a batch."""
    posterior, inputs = found.posterior, found.problem
    if posterior is None:
        return
    for k, band in enumerate(found.bands[:RUNS], 1):
        caption = f"Measured and identified transmission error, {band.run.at.text()}"
        yield Figure(f"curve_{k}", caption, partial(_curve, band))
        yield Figure(
            f"measurement_{k}",
            f"Readings, their contents and the rest, {band.run.at.text()}",
            partial(_contents, found, k - 1),
        )
    if inputs.kind == "curve":
        yield Figure("orders", "Residual of each order, and the noise", partial(_orders, found))
    if inputs.kind == "loop" and isinstance(loop := inputs.items[0][0], Loop):
        curves = loop.torque, loop.midline, loop.width, np.asarray(posterior.prediction["angle"])
        kept = loop.recorded
        samples = None if kept is None else (kept.torque, kept.angle, kept.branch)
        draw = lambda: rvjax.plotting.measured_loop(*curves, recorded=samples)  # noqa: E731
        yield Figure("loop", "Midline of the measured loop and of the identified unit", draw)
    caption = "Every element: prior (grey), posterior, and the limits of the drawing"
    yield Figure("elements", caption, partial(_elements, found))
    caption = "Share of each error in the curve; a negative share cancels others"
    yield Figure("shares", caption, lambda: rvjax.plotting.observation_shares(posterior.shares))


def _curve(band: Band) -> "Axes":
    mean, cosine, sine = band.taken
    return rvjax.plotting.identified_curve(
        band.run.angle,
        band.run.error - mean - cosine * np.cos(band.run.angle) - sine * np.sin(band.run.angle),
        predicted_angle=band.angle,
        predicted=band.value,
        lower=band.lower,
        upper=band.upper,
        title=band.run.at.text(),
    )


def _contents(found: Identified, place: int) -> "Axes":
    run = found.problem.items[0][place]
    assert isinstance(run, Run)
    judged = judge(run, orders_of(found.study.design))
    model, used = judged.model, np.isin(judged.model.angle, judged.angle)  # no bad reading
    return rvjax.plotting.measured_contents(
        model.angle[used], model.value[used], (model.value - model.residual)[used], title=run.at.text()
    )


def _orders(found: Identified) -> "Axes":
    assert found.posterior is not None
    residual = {name: np.asarray(x) for name, x in found.posterior.residual.items() if name != "mean"}
    return rvjax.plotting.residual_orders(residual, found.problem.sd)


def _elements(found: Identified) -> "Axes":
    posterior, inputs = found.posterior, found.problem
    assert posterior is not None
    prior = {name: tolerance for name, tolerance in inputs.prior.items() if name not in inputs.nuisance}
    held = posterior.problem.elements
    reached = held.structure(mapped_values(held, np.outer(SIDES, np.ones(held.count))))
    ends = [elements({f: reached[f][k] for f in prior}) for k in range(len(SIDES))]
    sides = (posterior.value, posterior.lower, posterior.upper)
    value, lower, upper = (elements({f: side[f] for f in prior}) for side in sides)
    # The tolerance of a vector limits its length: each component lies within it on both sides.
    limits = {f: (-float(t.upper) if t.is_vector else float(t.lower), float(t.upper)) for f, t in prior.items()}
    names = sorted(value, key=lambda name: -found.check.resolution[name])
    return rvjax.plotting.identified_elements(
        names,
        before={name: (ends[0][name], ends[1][name]) for name in names},
        after={name: (value[name], lower[name], upper[name]) for name in names},
        limits={name: limits[field_of(name)] for name in names},
        verdict=found.check.verdict,
    )
