"""The design of a study as a section of its page: every number and where it comes from, and a drawing to scale."""

from html import escape
from typing import Any

from rvjax import catalogue
from rvjax.designs import RVReducer
from rvjax.plotting.style import words
from rvjax.report.html import figure, micro, section, table
from rvjax.report.pictures import Picture, saved
from rvjax.study.facts import facts_of
from rvjax.study.plausible import shown
from rvjax.study.question import Study


def design_section(study: Study) -> str:
    """The section as HTML."""
    drawn = figure(drawing(study.design)) if isinstance(study.design, RVReducer) else ""
    cells = []
    for number in study.numbers:
        title = f"{escape(words(number.path.replace('.', ' ')))}<small>{escape(number.meaning)}</small>"
        mark = "<strong>assumed</strong>" if number.assumed else ""
        cells.append([title, _typed(value_text(number.value, number.unit)), escape(number.origin), mark])
    for name, value in facts_of(study.design):
        cells.append([escape(name), _typed(value), "follows from the numbers above", ""])
    assumed = (
        "<p>Nobody printed the numbers marked <strong>assumed</strong>: the answer holds as far as they do.</p>"
        if study.assumed
        else ""
    )
    cited = f"<p>{escape(study.base)} is {escape(catalogue.citation(study.base))}</p>" if study.base else ""
    listed = table(["number", "value", "from", "note"], cells)
    return section("The reducer", f'<div class="reducer">{drawn}{assumed}{cited}{listed}</div>')


def _typed(value: str) -> str:
    return micro(escape(value))


def value_text(value: Any, unit: str) -> str:
    """A number of a design with its unit; of an array the elements."""
    if getattr(value, "shape", ()) or isinstance(value, list | tuple):
        return ", ".join(value_text(item, unit) for item in value)
    return shown(value, unit) if unit != "-" else f"{float(value):.6g}"


def drawing(design: RVReducer) -> Picture:
    """The second stage to scale, as SVG."""
    import matplotlib.pyplot as plt

    from rvjax import plotting
    from rvjax.plotting import drawings

    with plotting.style():
        canvas = plt.figure(figsize=(7, 7))
        drawings.reducer(design, axes=canvas.add_subplot())
        content = saved(canvas, "svg")
    cycloid = design.cycloid
    caption = (
        f"Second stage along its axis, to scale; diameters: {cycloid.pin_count} pins of "
        f"{shown(2 * cycloid.pin_radius, 'm')} on a circle of {shown(2 * cycloid.pin_circle_radius, 'm')}, one of "
        f"{cycloid.disc_count} discs, {design.cranks.count} cranks on a circle of "
        f"{shown(2 * design.cranks.circle_radius, 'm')}"
    )
    return Picture("design", caption, content)
