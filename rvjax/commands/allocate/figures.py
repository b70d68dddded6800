"""Plots of a result: curves of sample units, a histogram for each requirement, variance shares, cost against yield."""

import math
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import rvjax
from rvjax.commands.allocate.answer import Answer
from rvjax.render import Figure
from rvjax.tolerances import least_yield
from rvjax.units import with_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def figures(answer: Answer) -> Iterator[Figure]:
    """Draw the plots of a result."""
    study = answer.study
    if study.curve is not None:
        yield Figure("curves", f"{study.curve.title} of sample units, before and after", partial(_curves, answer))
    for name in study.requirements:
        yield Figure(f"histogram_{name}", _caption(answer, name), partial(_histogram, answer, name))
    yield Figure(
        "variance_shares",
        "Share of each error in the variance of each response, after",
        lambda: rvjax.plotting.variance_shares(answer.after.shares, title="Shares of the variance, after"),
    )
    if answer.cost_curve:
        ends = [f"{cost:.3g} at {100 * share:.5g} %" for share, cost in (answer.cost_curve[0], answer.cost_curve[-1])]
        caption = f"Cheapest cost for each yield, from {' to '.join(ends)}, with this study and the start"
        yield Figure("cost_against_yield", caption, partial(_costs, answer))


def _curves(answer: Answer) -> "Axes":
    study, curve = answer.study, answer.study.curve
    assert curve is not None
    alike = (output for name in study.requirements if (output := study.output(name)).unit == curve.unit)
    read_in = next((output.read_in for output in alike), None)
    sides = answer.before.curves, answer.after.curves
    return rvjax.plotting.unit_curves(answer.after.angle, *sides, curve.title, curve.unit, read_in=read_in)


def _caption(answer: Answer, name: str) -> str:
    study, certificate, values = answer.study, answer.allocation.certificate, answer.after.values[name]
    caption = f"Distribution of {name.replace('_', ' ')} before and after, with its limits"
    valid = values[np.isfinite(values)]
    if not valid.size:
        return caption
    unit, size = study.output(name).shown
    mean, sd = (with_unit(number / size, unit, ".3g") for number in (valid.mean(), valid.std()))
    caption += f"; after: mean {mean}, sd {sd}"
    known = (("Cp", certificate.cp_estimate), ("Cpk", certificate.cpk_estimate))
    return caption + "".join(
        f", {label} {found[name].value:.3g}" for label, found in known if found and math.isfinite(found[name].value)
    )


def _histogram(answer: Answer, name: str) -> "Axes":
    output, requirement = answer.study.output(name), answer.study.requirements[name]
    return rvjax.plotting.histogram(
        {"after": answer.after.values[name], "before": answer.before.values[name]},
        unit=output.unit,
        read_in=output.read_in,
        name=name,
        limits=(requirement.lower, requirement.upper) if requirement.limits_values else (),
    )


def _costs(answer: Answer) -> "Axes":
    return rvjax.plotting.cost_against_yield(
        *zip(*answer.cost_curve),
        chosen=(least_yield(answer.allocation.certificate), answer.allocation.cost),
        start=(least_yield(answer.certificate_before), answer.allocation.start_cost),
    )
