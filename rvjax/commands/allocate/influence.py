"""Tables of influences: for each response the errors that cause most of it, and all of them in the file."""

from dataclasses import dataclass

from rvjax.commands.allocate.answer import Answer
from rvjax.commands.cells import KNOWN, SHARE_MEANS, UNMOVED_MEANS, influence_share, slope_text, together_text
from rvjax.render import CSV, EVERYWHERE, Cell, Column, Interval, Note, Table, Text, number
from rvjax.units import readable

NOT_IN_FILE, IN_FILE = EVERYWHERE - {CSV}, frozenset({CSV})
MOST_ERRORS = 6  # of a response in text and page


def influence_tables(answer: Answer) -> list[Table | Note]:
    """Mean slope of each response along each error and share of the variance, with its interval, after.

    In text and page a table for each response with the errors that cause most of it; in the file all of them.
    """
    found = answer.after.influence
    titles = ("error", "response", "slope", "unit of the slope", "share of variance")
    ends = ("share, lower end", "share, upper end", "slope of a unit, rms")
    rows = [_influence_row(answer, field, name) for field in answer.study.fields for name in found]
    means = Note("\n".join(filter(None, [UNMOVED_MEANS, SHARE_MEANS, together_text(found)])))
    shown = (_influence_on(answer, name) for name in answer.study.requirements)
    return [Table("influence", [Column(title) for title in (*titles, *ends)], rows, on=IN_FILE), *shown, means]


def _influence_row(answer: Answer, field: str, name: str) -> list[Cell]:
    """Numbers of an error and a response for the file."""
    study, one = answer.study, answer.after.influence[name]
    (error_unit, error_size), (unit, size) = readable(study.unit(field)), study.output(name).shown
    mean, single = (each[field] * error_size / size or None for each in (one.slopes, one.scatter))
    known = one.shares[field]
    three = (known.value, known.lower, known.upper) if influence_share(one, field) else (None, None, None)
    return [field, name, number(mean), f"{unit}/{error_unit}", *map(number, three), number(single)]


def _influence_on(answer: Answer, name: str) -> Table:
    """The errors that cause most of a response, the largest share first, and what the others cause together."""
    study, one = answer.study, answer.after.influence[name]
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
