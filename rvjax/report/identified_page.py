"""An identification as one HTML page, and its pictures: curve, residual orders, elements, shares."""

import shlex
from collections.abc import Iterator, Sequence
from html import escape
from typing import Any

import jax.numpy as jnp
import numpy as np

from rvjax.plotting.style import words
from rvjax.report import identified as told
from rvjax.report.html import boxes, document, figure, micro, note, origin, section, table
from rvjax.report.pictures import Picture, saved
from rvjax.study.identified import Identified
from rvjax.study.measured import Loop
from rvjax.tolerances import Tolerance

RUNS = 4  # curves that are drawn
MOST = 40  # elements of the table of the page
SIDES = np.array([-1.959964, 1.959964])  # of a 95 % interval


def pictures(answer: Identified, form: str = "png") -> Iterator[Picture]:
    """Draw an answer."""
    from rvjax import plotting

    with plotting.style():
        for name, caption, axes in _drawn(answer):
            yield Picture(name, caption, saved(axes.figure, form))


def _drawn(answer: Identified) -> Iterator[tuple[str, str, Any]]:
    from rvjax.plotting import identified as draw

    found, asked = answer.posterior, answer.problem
    if found is None:
        return
    for k, band in enumerate(answer.bands[:RUNS]):
        mean, cosine, sine = band.taken
        error = band.run.error - mean - cosine * np.cos(band.run.angle) - sine * np.sin(band.run.angle)
        axes = draw.measured_curve(
            band.run.angle,
            error,
            predicted_angle=band.angle,
            predicted=band.value,
            lower=band.lower,
            upper=band.upper,
            title=band.run.at.text(),
        )
        yield f"curve_{k + 1}", f"Measured and identified transmission error, {band.run.at.text()}", axes
    residual = {name: np.asarray(value) for name, value in found.residual.items()}
    if asked.kind == "curve":
        orders = {name: value for name, value in residual.items() if name != "mean"}
        yield "orders", "What is left over of each order, beside the noise", draw.residual_orders(orders, asked.sd)
    if asked.kind == "loop" and isinstance(loop := asked.items[0][0], Loop):
        predicted = np.asarray(found.prediction["angle"])
        axes = draw.loop(loop.torque, loop.midline, loop.width, predicted)
        yield "loop", "Midline of the measured loop and of the identified unit", axes
    prior = {name: tolerance for name, tolerance in asked.prior.items() if name not in asked.nuisance}
    ends = [_at(prior, side) for side in SIDES]
    value, lower, upper = (told.elements({f: x[f] for f in prior}) for x in (found.value, found.lower, found.upper))
    limits = {f: (float(t.lower), float(t.upper)) for f, t in prior.items()}
    names = sorted(value, key=lambda name: -answer.check.resolution[name])
    axes = draw.elements(
        names,
        before={name: (ends[0][name], ends[1][name]) for name in names},
        after={name: (value[name], lower[name], upper[name]) for name in names},
        limits={name: limits[told.field_of(name)] for name in names},
        verdict=answer.check.verdict,
    )
    yield "elements", "Every element: prior (grey), posterior, and the limits of the drawing", axes
    yield "shares", "Who makes the curve; a negative share cancels others", draw.shares(found.shares)


def _at(prior: dict[str, Tolerance], side: float) -> dict[str, float]:
    """{element: value} of every element at a quantile of its law."""
    return told.elements({f: t.deviate(jnp.full(t.shape, side)) for f, t in prior.items()})


def page(answer: Identified, study: str, data: Sequence[str]) -> str:
    """The whole page."""
    drawn = {picture.name: picture for picture in pictures(answer, "svg")}
    parts = [_head(answer), _curves(answer, drawn), _seen(answer), _elements(answer, drawn), _units(answer)]
    parts += [_shares(drawn), _coming(answer), _origin(answer, study, data)]
    body = "\n".join(filter(None, parts))
    return document(f"{answer.study.name}: what made this curve", body)


def _head(answer: Identified) -> str:
    found = answer.posterior
    title, *more = told.headline(answer).split("\n")
    figures = []
    if found is not None:
        fit = found.fit
        figures = [
            ("can any part do this?", f"p = {fit.p_model:.3g}", f"chi² {fit.chi2_model:.4g} of {fit.dof_model:g}"),
            ("a part of this drawing?", f"p = {fit.p_prior:.3g}", f"chi² {fit.chi2_prior:.4g} of {fit.dof_prior:g}"),
        ]
    figures.append(
        ("information", f"{answer.check.information:.3g} nats", f"{len(answer.check.directions)} directions")
    )
    if answer.problem.kind == "curve":
        figures.append(("noise", f"{answer.problem.sd / told.arcsec:.3g} arcsec", "of a real number"))
    missed = "" if answer.adequate in (True, None) else " missed"
    mark = "✔ " if answer.adequate else ("" if answer.adequate is None else "✘ ")
    said = " ".join(map(escape, [*more, told.verdict_line(answer) + "."]))
    return (
        f"<header>\n<h1>{escape(answer.study.name)}: what made this curve?</h1>\n"
        f'<p class="note">{escape(note(answer.study.text))}</p>\n'
        f'<div class="verdict{missed}"><strong>{mark}{escape(title)}</strong> {said}</div>\n'
        f"{boxes(figures)}\n</header>"
    )


def _curves(answer: Identified, drawn: dict[str, Picture]) -> str:
    chosen = [picture for name, picture in drawn.items() if name.startswith(("curve_", "loop"))]
    if not chosen:
        return ""
    left = f"<p>{len(answer.bands) - RUNS} more runs are not drawn.</p>" if len(answer.bands) > RUNS else ""
    text = (
        "<p>Points: what was measured, without order 1 and, where no offset is asked for, without its mean. "
        "The band holds what the identified unit does, not the noise of a reading.</p>"
    )
    orders = figure(drawn["orders"]) if "orders" in drawn else ""
    return section("Measured and identified", text + "".join(map(figure, chosen)) + left + orders)


def _seen(answer: Identified) -> str:
    lines = told.direction_lines(answer)
    seen = "".join(f"<li>only {escape(line)}</li>" for line in lines) or "<li>nothing beyond the drawing</li>"
    text = f"<p>What the data weigh more than the drawing, strongest first:</p><ol>{seen}</ol>"
    fields = sorted({told.field_of(name) for name in answer.silent} - set(answer.problem.nuisance))
    if fields:
        text += (
            f"<p>The data say nothing of {escape(', '.join(map(words, fields)))}; their values are the drawing's.</p>"
        )
    pairs = [f"{escape(a)} and {escape(b)} ({r:+.3f})" for a, b, r in answer.check.inseparable[:8]]
    if pairs:
        text += f"<p>Cannot be told apart (posterior correlation): {', '.join(pairs)}.</p>"
    return section("What the data can tell apart", text)


def _elements(answer: Identified, drawn: dict[str, Picture]) -> str:
    headers, rows = told.element_rows(answer)
    cells = [[_broken(row[0]), *(micro(escape(cell)) for cell in row[1:])] for row in rows[:MOST]]
    left = (
        f"<p>{len(rows) - MOST} elements of which the data say less are in elements.csv.</p>"
        if len(rows) > MOST
        else ""
    )
    picture = figure(drawn["elements"]) if "elements" in drawn else ""
    return section("Every element", picture + table(headers, cells) + left)


def _broken(element: str) -> str:
    return escape(words(element)).replace("[", "<wbr>[")


def _units(answer: Identified) -> str:
    if answer.batch is None:
        return ""
    headers, rows = told.unit_rows(answer)
    return section("Units", table(headers, [[micro(escape(cell)) for cell in row] for row in rows]))


def _shares(drawn: dict[str, Picture]) -> str:
    return section("Who makes the curve", figure(drawn["shares"])) if "shares" in drawn else ""


def _coming(answer: Identified) -> str:
    lines = "".join(f"<li>{escape(line)}</li>" for line in told.next_lines(answer))
    if not lines:
        return ""
    text = "<p>One more run, and how much it would tell about the parts (a nat: some uncertainty divided by 2.7):</p>"
    return section("What to measure next", f"{text}<ol>{lines}</ol>")


def _origin(answer: Identified, study: str, data: Sequence[str]) -> str:
    command = " ".join(["rvjax identify", *(shlex.quote(name) for name in (study, *data))])
    return origin({"command": command, "seed": str(answer.study.seed)}, answer.study.text)
