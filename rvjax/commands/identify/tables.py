"""Report of `rvjax identify`: verdict, combinations, elements, shares, next measurement; one page with its plots."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

import rvjax
from rvjax.base.fields import place_of
from rvjax.commands.cells import measurement_section, measurement_warnings
from rvjax.commands.identify.identified import Band, Identified, field_of, unit_of
from rvjax.commands.identify.words import (
    combinations,
    doubts,
    elements,
    head_lines,
    head_of,
    headline,
    next_lines,
    shares_text,
    verdict_line,
)
from rvjax.identify import mapped_values
from rvjax.measured import judge
from rvjax.render import (
    CSV,
    EVERYWHERE,
    PAGE,
    TEXT,
    Cell,
    Column,
    Content,
    Figure,
    Interval,
    Note,
    Number,
    Quantity,
    Section,
    Share,
    Table,
    Text,
    column,
)
from rvjax.study import Loop, Run, orders_of, part_orders

MOST_ROWS, MOST_ON_PAGE, MOST_UNITS = 60, 40, 6
SHOWN = frozenset({TEXT, PAGE})
SEEN = 1e-3  # resolution of the elements that a table of text lists
NIL = 1e-4  # share of an interval, or chance, that is rounding


def content(found: Identified, drawn: dict[str, Figure]) -> list[Content]:
    """Text, tables and figures of an identification.

    Args:
        found: result of the command.
        drawn: its figures by name.
    """
    only_text, only_page = frozenset({TEXT}), frozenset({PAGE})
    silent = sorted({field_of(name) for name in found.silent} - set(found.problem.nuisance))
    unknown = f"The data do not determine {', '.join(silent)}: only the limits of the drawing are known."
    said = [verdict_line(found), *([unknown] if silent else [])]
    content: list[Content] = [Note(headline(found), only_text), Note("\n".join(said), only_text)]
    if warned := [*doubts(found), *measurement_warnings(found.findings)]:
        content.append(Note("\n".join(warned)))
    if curves := [figure for name, figure in drawn.items() if name.startswith(("curve_", "loop"))]:
        points = (
            "Points: measured values without order 1 (and without their mean, if the study has no offset). The band "
            "contains the curve of the identified unit, not the noise of a reading."
        )
        left = len(found.bands) - RUNS
        parts: list[Note | Table | Figure] = [Note(points, only_page), *curves]
        parts += [Note(f"{left} more runs are not plotted.", only_page)] if left > 0 else []
        content.append(Section("Measured and identified", (*parts, *_named(drawn, "orders"))))
    content += measurement_section(found.findings, [f for name, f in drawn.items() if name.startswith("measurement")])
    content.append(Section("Identifiable errors", (_seen(found), *([Note(unknown, only_page)] if silent else []))))
    content.append(Section("Every element", (*_named(drawn, "elements"), *_elements(found))))
    if found.problem.notes:
        content.append(Section("Files", (Note("\n".join(found.problem.notes)),)))
    if found.batch is not None:
        content.append(Section("Units", (_units(found),)))
    if found.posterior is not None:
        shares = [f"  {group}: {shares_text(fields)}" for group, fields in found.posterior.shares.items()]
        text = Note("\n".join(["Shares of the errors in the curve (negative: cancels others):", *shares]), only_text)
        content.append(Section("Shares of the errors", (text, *_named(drawn, "shares"))))
    if rest := _fit_lines(found):
        content.append(Note("\n".join(rest), only_text))
    if coming := next_lines(found):
        more = "One more run, and its information about the parts (a nat: some uncertainty divided by 2.7):"
        listed = [f"  {line}" for line in coming]
        notes = Note("\n".join(["Measure next:", *listed]), only_text), Note("\n".join([more, *listed]), only_page)
        content.append(Section("What to measure next", notes))
    return content


def _named(drawn: dict[str, Figure], name: str) -> list[Figure]:
    return [drawn[name]] if name in drawn else []


def _seen(found: Identified) -> Note:
    """Combinations that the data see, and pairs that they cannot separate."""
    lines = [f"  {combination.text()}" for combination in combinations(found)] or ["  nothing beyond the drawing"]
    lines.insert(0, "Combinations that the data determine, strongest first:")
    if alone := orders_of_parts(found):
        orders = ", ".join(map(str, alone))
        lines.append(f"Only errors of parts or the mounting make order {orders}; the housing cannot.")
    if found.posterior is not None and (head := head_of(found.posterior)):
        lines += head_lines(head)
    if pairs := found.check.inseparable:
        shown = [f"{a} and {b} ({r:+.3f})" for a, b, r in pairs[:5]]
        lines.append(f"Not distinguishable: {', '.join(shown)}{', ..' if len(pairs) > 5 else ''}")
    return Note("\n".join(lines))


def orders_of_parts(found: Identified) -> tuple[int, ...]:
    """Orders of a curve that no effect of the housing and no head makes."""
    return part_orders(found.study.design, found.problem.identification.orders) if found.problem.kind == "curve" else ()


def _fit_lines(found: Identified) -> list[str]:
    """Largest residuals, and whether draws agree."""
    lines = []
    if found.posterior is not None:
        lines.append(f"Largest residuals: {', '.join(map(str, found.posterior.fit.worst[:3]))}")
    if found.draws is not None and found.draws.trusted:
        lines.append(f"Sampled: chains agree, largest r_hat {np.max(found.draws.r_hat):.4f}")
    return lines


def _texts(found: Quantity) -> tuple[str, str]:
    """Most probable value and 95 % interval; a number that is 0 but for rounding is shown as 0."""
    assert found.lower is not None and found.upper is not None
    (name, size), least = found.shown, NIL * (found.upper - found.lower)
    ends = (found.value, found.lower, found.upper)
    value, lower, upper = (f"{0.0 if abs(end) < least else end / size:.4g}" for end in ends)
    return f"{value} {name}", f"{lower} .. {upper}"


@dataclass(frozen=True)
class _Chance(Share):
    """Chances; those of rounding are not shown."""

    def _said(self, cell: float) -> str:
        return super()._said(cell) if cell >= NIL else self.missing


@dataclass(frozen=True)
class ElementRow:
    """An element of an error: what the data say of it."""

    element: str = column(Text("element"))
    unit: str = column(Text("unit", on=frozenset({CSV})))
    verdict: str = column(Text("verdict"))
    resolution: float = column(Share("known better by"))
    value: str | None = column(Text("value", on=SHOWN), None)
    span: str | None = column(Text("95 % interval", on=SHOWN), None)
    number: float | None = column(Number("value", on=frozenset({CSV})), None)
    lower: float | None = column(Number("lower", on=frozenset({CSV})), None)
    upper: float | None = column(Number("upper", on=frozenset({CSV})), None)
    broken: float | None = column(_Chance("beyond limit", file_title="chance beyond limit", form=".3g"), None)


def _elements(found: Identified) -> list[Table | Note]:
    """Every element, those that the data move most first: all in the file, those that matter in text and page."""
    check, posterior = found.check, found.posterior
    fields = posterior and [elements(x) for x in (posterior.value, posterior.lower, posterior.upper)]
    rows = []
    for name in sorted(check.names, key=lambda name: -check.resolution[name]):
        about = name, unit_of(found, name)[1], str(check.verdict[name]), max(check.resolution[name], 0.0)
        if posterior is not None and fields:
            size = _quantity(found, name, *(values[name] for values in fields))
            value, lower, upper = size.numbers()
            rows.append(ElementRow(*about, *_texts(size), value, lower, upper, posterior.broken.get(name, 0.0)))
        else:
            rows.append(ElementRow(*about))
    seen = [row for row in rows if check.resolution[row.element] >= SEEN][:MOST_ROWS]
    left = len(rows) - len(seen)
    rest = f"{left} more elements: limits of the drawing" if left else ""
    more = f"{len(rows) - MOST_ON_PAGE} elements that the data determine less are in elements.csv."
    table = functools.partial(Table.of, ElementRow, "elements")
    without = ("value", "span", "broken") if posterior is None else ()
    return [
        table(rows, on=frozenset({CSV})),
        table(seen, without=without, note=rest, on=frozenset({TEXT})),
        table(rows[:MOST_ON_PAGE], without=without, on=frozenset({PAGE})),
        *([Note(more, frozenset({PAGE}))] if len(rows) > MOST_ON_PAGE else []),
    ]


def _quantity(found: Identified, name: str, value: float, lower: float, upper: float) -> Quantity:
    unit, shown, _ = unit_of(found, name)
    return Quantity(value, unit, lower, upper, shown)


def _units(found: Identified) -> Table:
    """Every unit of a batch: status, fit, and the elements that are identified; all of these in the file."""
    batch = found.batch
    assert batch is not None
    own = [n for n in found.check.names if found.check.verdict[n] == "identified"]
    own = [n for n in own if field_of(n) not in found.problem.nuisance]
    columns: list[Column] = [Text("unit"), Text("status"), Number("p model", form=".3g"), Number("p prior", form=".3g")]
    for k, name in enumerate(own):
        shown = unit_of(found, name)[1]
        ends = f"{name} lower [{shown}]", f"{name} upper [{shown}]"
        on = EVERYWHERE if k < MOST_UNITS else frozenset({CSV})
        columns.append(Interval(name, ends=ends, file_title=f"{name} [{shown}]", on=on))
    rows = []
    for k, unit in enumerate(found.problem.units):
        chances = (float(np.asarray(p)[k]) for p in (batch.fit.p_model, batch.fit.p_prior))
        row: list[Cell] = [unit or "-", str(batch.status[k]), *chances]
        for name in own:
            field, at = place_of(name)
            numbers = (float(np.asarray(x[field])[(k, *at)]) for x in (batch.value, batch.lower, batch.upper))
            row.append(_quantity(found, name, *numbers))
        rows.append(row)
    return Table("units", columns, rows)


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
    yield Figure("elements", caption, partial(_elements_plotted, found))
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
    return rvjax.plotting.measured_contents(judge(run, orders_of(found.study.design)), title=run.at.text())


def _orders(found: Identified) -> "Axes":
    assert found.posterior is not None
    residual = {name: np.asarray(x) for name, x in found.posterior.residual.items() if name != "mean"}
    return rvjax.plotting.residual_orders(residual, found.problem.sd)


def _elements_plotted(found: Identified) -> "Axes":
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
