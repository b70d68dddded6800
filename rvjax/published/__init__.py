"""Comparison with the literature: published values as data, compared with the results of the models.

One TOML file per source. Fields of a `[[figure]]`::

    id               source.section.short_name, unique
    where, claim     place in the source, the value or statement in other words
    value, unit      as published; true for a statement that is either right or wrong (unit "bool")
    inputs           what to set to obtain our_value
    compute          where several figures are formed alike: how, and of what, as the module of the source defines
    our_value        what the right model gives, in `our_unit` where present, else `unit`
    tolerance        absolute tolerance on our_value, element by element
    rounding         half the last published digit
    expected_status  the verdict the tests hold the computed one against
    reading          the interpretation under which the figure comes out; not evidence for it
    contradicted_by  what contradicts the value, where our value lies outside the band about it
    judging_value    our number that tests a value without a direct counterpart; in the note only
    judging_unit     its unit where it is another one
    presupposes      what it is held against instead of the figure, in that unit
    missing          what the source leaves out
    calibrated       an input was chosen so that the figure comes out: close at best, never reproduced
    type             "predict": no number of the figure entered the model (the default);
                     "consistent": an inequality with stated assumptions, which can fail and confirms nothing
    grade            of a source that was not read itself: B two independent quotes agree, C one quote, or recalled
    note             further remarks

Status words: reproduced (within rounding), reproduced_with_reading, close (within 10 %), consistent (an inequality
holds), not_computable; contradicted (our value is further from the figure than rounding and tolerance together, and
`contradicted_by` says why the value is at fault); not_reproduced (further than 10 % without an explanation). The last
one is a defect of rvjax or a reading
that was never found: the ledger holds no such figure, and a test forbids it. Every verdict but not_computable follows
from the computed number, `contradicted` too: a model that moves into the band ends it, and the test turns red.
"""

import importlib
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from rvjax.records import PyTree

__all__ = ["SOURCES", "Comparison", "compare", "figures", "ours", "parse", "reproduce", "show"]


SOURCES = ("corr", "rv20e", "rv320e", "rv40e", "rv160", "catalogue", "sizes")
"""Sources in the ledger; each has a TOML file, and a module of its name or in `HOMES` with a dict `COMPUTED`."""
HOMES = {"catalogue": "sizes"}

Figure = dict[str, Any]  # as in the TOML file of a source

CLOSE = 0.10


@dataclass(frozen=True)
class Comparison:
    """One published value and the computed one.

    `right` is the physically right value where the published figure follows only under a reading.
    """

    id: str
    claim: str
    published: object
    computed: object
    unit: str
    status: str
    note: str
    right: object = None

    def as_json(self) -> dict[str, object]:
        """Return the fields meant for machines."""
        names = ("id", "published", "computed", "unit", "status", "note")
        return {name: getattr(self, name) for name in names}


def figures(source: str) -> list[Figure]:
    """Return the figures of one source, as in its TOML file."""
    return parse(source)["figure"]


@cache
def parse(source: str) -> Figure:
    """Return the whole ledger file of one source, read once: not to be changed."""
    return tomllib.loads((resources.files("rvjax.published") / f"{source}.toml").read_text("utf-8"))


def reproduce(
    sources: tuple[str, ...] = SOURCES, *, say: Callable[[str], object] = lambda text: None
) -> list[Comparison]:
    """Compute every figure of `sources` now and compare it with the published one; needs float64.

    Args:
        sources: names.
        say: receives the name of the next source.
    """
    rows = []
    for number, source in enumerate(sources):
        say(f"computing {source}, {number + 1} of {len(sources)}: {len(figures(source))} figures")
        module = importlib.import_module(f"rvjax.published.{HOMES.get(source, source)}")
        right = getattr(module, "RIGHT", {})
        for figure in figures(source):
            computed = None if ours(figure) is None else _call(module.COMPUTED[figure["id"]])
            rows.append(compare(figure, computed, _call(right.get(figure["id"]))))
    return rows


def ours(figure: Figure) -> object:
    """Return the number that the ledger holds a computed one against; None where the source does not allow one."""
    return figure.get("our_value", figure.get("judging_value"))


def compare(figure: Figure, computed: object, right: object = None) -> Comparison:
    """Compare one value.

    Args:
        figure: of the ledger.
        computed: our value; None where the source does not allow one.
        right: the physically right value, where another reading was required.
    """
    unit = str(figure.get("our_unit", figure["unit"]))
    notes = [figure[key] for key in ("contradicted_by", "missing", "reading", "calibrated", "note") if key in figure]
    notes = [f"{key}: {figure[key]}" for key in ("type", "grade") if key in figure] + notes
    status = _status(figure, computed)
    if status == "contradicted":
        notes.append(_where(figure, computed))
    if right is not None:
        notes.append(f"physically right: {show(right)} {unit}")
    return Comparison(
        id=figure["id"],
        claim=figure["claim"],
        published=figure["value"],
        computed=None if "judging_value" in figure else computed,
        unit=unit,
        status=status,
        note="; ".join(notes),
        right=right,
    )


def show(value: object) -> str:
    """Return a figure as short text: numbers to six digits, lists with spaces, yes and no for statements."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        shown = [show(v) for v in value]
        return " ".join(shown) if len(shown) <= 3 else f"{shown[0]} {shown[1]} .. {shown[-1]} ({len(shown)})"
    return value if isinstance(value, str) else f"{value:.6g}"


def _call(function: Callable[[], object] | None) -> object:
    return None if function is None else _plain(function())


def _plain(value: object) -> object:
    """Arrays and NumPy scalars as Python numbers, fit for JSON."""
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value.tolist() if hasattr(value, "tolist") else value


def _status(figure: Figure, computed: object) -> str:
    if computed is None:
        return "not_computable"
    if figure.get("type") == "consistent":
        return "consistent" if computed == figure["value"] else "not_reproduced"
    bands = _bands(figure, computed)
    if "contradicted_by" in figure and any(abs(a - b) > r + t for a, b, r, t in bands):
        return "contradicted"
    if all(abs(a - b) <= r * (1 + 1e-9) for a, b, r, _ in bands):
        if "calibrated" in figure:
            return "close"
        return "reproduced_with_reading" if "reading" in figure else "reproduced"
    if all(abs(a - b) <= CLOSE * abs(b) for a, b, _, _ in bands):
        return "close"
    return "not_reproduced"


def _bands(figure: Figure, computed: object) -> list[tuple[float, float, float, float]]:
    """Computed value, published value, half the last published digit and tolerance of each element."""
    published = _list(figure.get("presupposes", figure["value"]))
    ours, rounding, tolerance = _list(computed), _list(figure.get("rounding", 0.0)), _list(figure.get("tolerance", 0.0))
    rounding, tolerance = (x * len(published) if len(x) == 1 else x for x in (rounding, tolerance))
    return list(zip(ours, published, rounding, tolerance, strict=True))


def _where(figure: Figure, computed: object) -> str:
    """Return the numbers that make a contradiction."""
    if isinstance(figure.get("presupposes", figure["value"]), bool):
        return f"computed: {show(computed)}"
    unit = figure.get("judging_unit", figure.get("our_unit", figure["unit"]))
    outside = [x for x in _bands(figure, computed) if abs(x[0] - x[1]) > x[2] + x[3]]
    where = ", ".join(f"{show(a)} is outside {show(b)} +- {r + t:.2g} {unit}" for a, b, r, t in outside[:3])
    more = f" and {len(outside) - 3} more" if len(outside) > 3 else ""
    return f"computed: {where}{more}"


def _list(value: PyTree) -> list[float]:
    return list(value) if isinstance(value, (list, tuple)) else [value]
