"""Influence of errors on responses: shares and slopes, tables of those that cause most."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rvjax.outputs import Output
from rvjax.render import CSV, EVERYWHERE, Cell, Column, Interval, Note, Quantity, Table, Text, number
from rvjax.study import Study
from rvjax.tolerances import Influence
from rvjax.units import readable

UNMOVED = "no slope"
UNMOVED_MEANS = (
    "no slope: raising and lowering the error act alike, or the model ignores it (share -); "
    "rms: slope of single units, root mean square."
)
SHARE_MEANS = "share: variance that the error causes, alone and with others [95 %]; scaled to sum to 100 %."
KNOWN = 5e-4  # half of the last digit of a share: no interval within it is shown


def influence_share(found: Influence, field: str) -> Quantity | None:
    """Share of an error in the variance, with its interval; None if the error does nothing.

    Args:
        found: influences on a response.
        field: name of the error.
    """
    one = found.shares[field]
    if one.value == 0 and found.scatter[field] == 0:
        return None
    if one.upper - one.lower < KNOWN:
        return Quantity(one.value, read_in="%", form=".1f")
    return Quantity.of(one, read_in="%", form=".1f")


def slope_text(found: Influence, field: str, study: Study, output: Output) -> str:
    """Mean slope of a response along an error, or that there is none.

    Args:
        found: influences on the response.
        field: name of the error.
        study: with both.
        output: what the response is.
    """
    unit, size = output.shown
    per = f"{unit}/{readable(study.unit(field))[0]}"
    sizes = {name: readable(study.unit(name))[1] / size for name in found.slopes}
    shown = [slope * sizes[name] for each in (found.slopes, found.scatter) for name, slope in each.items()]
    largest = max((slope for slope in shown if math.isfinite(slope) and slope > 0), default=1.0)
    decimals = min(4, max(0, 3 - math.floor(math.log10(largest))))  # fewer where the largest then has four digits
    mean, single = (each[field] * sizes[field] for each in (found.slopes, found.scatter))
    if mean:
        return f"{mean:.{decimals}f} {per}"
    said = f"{single:.{decimals}f}"
    return f"{UNMOVED} [rms {said} {per}]" if float(said) > 0 else UNMOVED


def together_text(influence: Mapping[str, Influence]) -> str:
    """A line on responses in which errors act together; "" if there are none.

    Args:
        influence: of the errors, by response.
    """
    sums = {name: found.total for name, found in influence.items() if found.total.lower > 1 + KNOWN}
    said = ", ".join(f"{name} {100 * total.value:.0f} %" for name, total in sums.items())
    return f"errors act together; before scaling the shares sum to: {said}." if said else ""


NOT_IN_FILE, IN_FILE = EVERYWHERE - {CSV}, frozenset({CSV})
MOST_ERRORS = 6  # of a response in text and page


def influence_tables(study: Study, influence: Mapping[str, Influence]) -> list[Table | Note]:
    """Mean slope of each response along each error and share of the variance, with its interval, after.

    In text and page a table for each response with the errors that cause most of it; in the file all of them.

    Args:
        study: with the errors.
        influence: of the errors, by response.
    """
    titles = ("error", "response", "slope", "unit of the slope", "share of variance")
    ends = ("share, lower end", "share, upper end", "slope of a unit, rms")
    rows = [_influence_row(study, influence[name], field, name) for field in study.fields for name in influence]
    means = Note("\n".join(filter(None, [UNMOVED_MEANS, SHARE_MEANS, together_text(influence)])))
    shown = (_influence_on(study, influence[name], name) for name in study.requirements)
    return [Table("influence", [Column(title) for title in (*titles, *ends)], rows, on=IN_FILE), *shown, means]


def _influence_row(study: Study, one: Influence, field: str, name: str) -> list[Cell]:
    """Numbers of an error and a response for the file."""
    (error_unit, error_size), (unit, size) = readable(study.unit(field)), study.output(name).shown
    mean, single = (each[field] * error_size / size or None for each in (one.slopes, one.scatter))
    known = one.shares[field]
    three = (known.value, known.lower, known.upper) if influence_share(one, field) else (None, None, None)
    return [field, name, number(mean), f"{unit}/{error_unit}", *map(number, three), number(single)]


def _influence_on(study: Study, one: Influence, name: str) -> Table:
    """The errors that cause most of a response, the largest share first, and what the others cause together."""
    acting = [field for field in study.fields if influence_share(one, field)]
    acting.sort(key=lambda field: -one.shares[field].value)
    listed = [field for field in acting[:MOST_ERRORS] if not one.shares[field].value < KNOWN]
    rows = [[f, influence_share(one, f), slope_text(one, f, study, study.output(name))] for f in listed]
    others, left = acting[len(listed) :], len(study.fields) - len(acting)
    rest = [f"{len(others)} more: {100 * sum(one.shares[field].value for field in others):.2g} %"] if others else []
    rest += [f"{left} without influence"] if left else []
    columns: list[Column] = [Text("error"), Interval("share [interval]"), _Slope(f"d {name} / d error")]
    note = f"{'; '.join(rest)} (influence.csv)" if rest else ""
    return Table("influence", columns, rows, f"Influence on {name}:", note, on=NOT_IN_FILE)


@dataclass(frozen=True)
class _Slope(Text):
    """Mean slopes, or "no slope" with the root mean square of single units."""

    @property
    def narrow(self) -> int:
        """The root mean square may be on the next line."""
        return 20
