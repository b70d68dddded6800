"""Scaling laws of a kind of reducer: other numbers that follow a number that changes;
tables of an embedded study with scaled values, line by line: comments and order stay.

The ratio of a number to its value in the study gives the ratio of the numbers that follow. A number that the study
gives does not follow. Without scaling laws an optimum would buy stiffness that no bearing of its size has.
"""

import dataclasses
import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import jax.numpy as jnp

from rvjax.records import Design, PyTree, Record, Scalar
from rvjax.study.values import in_unit

Follow = Callable[[PyTree, Mapping[str, Scalar], Mapping[str, PyTree], Collection[str]], Mapping[str, PyTree]]


def _nothing_else(*_: object) -> dict[str, PyTree]:
    """No numbers."""
    return {}


@dataclass(frozen=True)
class Law:
    """One scaling law.

    Attributes:
        name: of what follows.
        numbers: paths in the design that follow.
        follows: {path of the number that changes: exponent of its ratio}.
        interval: ratios of these numbers within which the scaling law is used.
        source: of the scaling law.
        whole: for a reducer of another size only, not where single numbers change.
        exact: kinematics, also used without scaling laws: gears that do not obey it do not mesh.
        unless: path of a number; a design that has it does not obey the scaling law. "": every one does.
    """

    name: str
    numbers: tuple[str, ...]
    follows: Mapping[str, float]
    interval: tuple[float, float]
    source: str
    whole: bool = False
    exact: bool = False
    unless: str = ""

    def holds(self, design: object) -> bool:
        """True for a design that obeys the scaling law."""
        return not self.unless or number_at(design, self.unless) is None


@dataclass(frozen=True)
class Following:
    """Numbers of a kind of design that follow others; by default none.

    Attributes:
        laws: scaling laws, ordered: a number that follows comes before the numbers that follow it.
        others: (design, new values, these with all that follows by scaling laws, paths that do not follow) -> values
            by path that follow otherwise.
        bound: {path: numbers that must follow it}; a study that gives one of them cannot vary the path.
        instead: {path of a number that cannot vary: what it follows from, and what to vary}.
    """

    laws: tuple[Law, ...] = ()
    others: Follow = _nothing_else
    bound: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    instead: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def changed(
        self,
        design: Record,
        values: Mapping[str, Scalar],
        given: Collection[str] = (),
        *,
        similar: bool = True,
        whole: bool = False,
    ) -> PyTree:
        """The design with other numbers, and with all that follows, see `rvjax.study.scaled`."""
        stands, new = {*values, *given}, dict[str, PyTree](values)
        for law in self.laws:
            used = (similar or law.exact) and (whole or not law.whole) and law.holds(design)
            ratios = {p: new[p] / number_at(design, p) for p in law.follows if used and new.get(p) is not None}
            for path in law.numbers if ratios else ():
                own = number_at(design, path)
                if path not in stands and own is not None:
                    new[path] = own * math.prod(ratio ** law.follows[p] for p, ratio in ratios.items())
        return replaced(design, new | dict(self.others(design, values, new, stands)))

    def called(
        self, design: Design, paths: Collection[str], given: Collection[str] = ()
    ) -> list[tuple[Law, list[str]]]:
        """Scaling laws that changes of some numbers call, each with the numbers of the design that follow.

        Args:
            design: the reducer.
            paths: of the numbers that change.
            given: paths of numbers that the study gives: they do not follow.
        """
        moving, found = set(paths), []
        for law in self.laws:
            if law.whole or not moving & set(law.follows) or not law.holds(design):
                continue
            numbers = [path for path in law.numbers if path not in {*paths, *given} and _there(design, path)]
            moving |= set(numbers)
            if numbers:
                found.append((law, numbers))
        return found


def number_at(design: object, path: str) -> PyTree:
    """Number of a design by its path, such as "cycloid.profile_modification[1]"; None where a part is missing."""
    names, element = split(path)
    for name in names:
        design = getattr(design, name, None)
    return design if element is None or design is None else jnp.asarray(design)[element]


def split(path: str) -> tuple[list[str], int | None]:
    """Names of the fields in a path, and the element that it ends with.

    Raises:
        ValueError: one line.
    """
    found = re.fullmatch(r"([\w.]+)(?:\[(\d+)\])?", path)
    if found is None:
        raise ValueError(f"{path}: must be a path in the design, such as cycloid.eccentricity")
    return found[1].split("."), None if found[2] is None else int(found[2])


def replaced(record: Record, changes: Mapping[str, object]) -> PyTree:
    """A record of records with numbers replaced, by path: every record is checked once, with all its new numbers.

    Args:
        record: such as a design.
        changes: new numbers by path.
    """
    own: dict[str, PyTree] = {}
    parts: dict[str, dict[str, PyTree]] = {}
    for path, value in changes.items():
        name, _, rest = path.partition(".")
        names, element = split(name)
        if rest:
            parts.setdefault(name, {})[rest] = value
        elif element is not None:
            own[names[0]] = jnp.asarray(own.get(names[0], getattr(record, names[0]))).at[element].set(value)
        else:
            own[name] = value
    return record.replace(**own, **{name: replaced(getattr(record, name), inner) for name, inner in parts.items()})


def _there(design: Design, path: str) -> bool:
    """True if the design has this number and it is not 0."""
    own = number_at(design, path)
    return own is not None and bool(jnp.any(jnp.asarray(own) != 0))


def outside(before: Design, after: Design, laws: Collection[Law], of: str = "the study") -> list[str]:
    """Numbers whose ratio lies outside the interval of a scaling law, a line each.

    Args:
        before: the design of the study.
        after: the design that was found.
        laws: scaling laws that were used.
        of: name of the design before.
    """
    found = []
    for path in dict.fromkeys(path for law in laws for path in law.follows):
        if (was := number_at(before, path)) is None:
            continue
        ratio = float(number_at(after, path) / was)
        for law in (law for law in laws if path in law.follows and not law.interval[0] <= ratio <= law.interval[1]):
            most = f"from {law.interval[0]:g} to {law.interval[1]:g} times (assumed)"
            found.append(f"{path}: {ratio:.3g} times that of {of}; {law.name} follow it {most}")
    return found


VALUE = re.compile(
    r'(?P<key>\w+)(?P<gap> *= *)"(?P<word>diametral )?(?P<number>-?[\d.]+) (?P<unit>[^"]+)"(?: *# *(?P<note>.*))?'
)
"""A line with a value and its unit."""


def rewritten(text: str, change: Callable[[tuple[str, ...], re.Match[str]], str]) -> str:
    """Text of tables with other values.

    Args:
        text: of the tables.
        change: (names of the table and the key, match of `VALUE`) -> the line.
    """
    table, made = tuple[str, ...](), []
    for line in text.splitlines():
        if header := re.match(r"\[+([\w.]+)\]+", line):
            table = tuple(header[1].split("."))
        elif match := VALUE.fullmatch(line):
            line = change((*table, match["key"]), match)
        made.append(line)
    return "\n".join(made) + "\n"


def stated(match: re.Match[str], value: str, *notes: str | None) -> str:
    """The line with another value.

    Args:
        match: of the line.
        value: with its unit.
        *notes: of its comment.
    """
    comment = "; ".join(filter(None, notes))
    line = f'{match["key"]}{match["gap"]}"{match["word"] or ""}{value}"'
    return f"{line} # {comment}" if comment else line


def scaled_line(path: tuple[str, ...], match: re.Match[str], ratios: Mapping[str, tuple[float, str]]) -> str:
    """The line with its length in um times the ratio of its error; unchanged where there is none.

    Args:
        path: names of the table and the key.
        match: of the line.
        ratios: (ratio, note) by error, or by "error.key".
    """
    number, names = float(match["number"]), (".".join(path[1:3]), path[1] if len(path) > 2 else "")
    ratio, note = next((ratios[name] for name in names if name in ratios), (1.0, ""))
    if match["unit"] != "um" or ratio == 1 or not number:
        return match[0]
    return stated(match, f"{number * ratio:.6g} um", match["note"], note)


def with_torque(path: tuple[str, ...], match: re.Match[str], torque: float | None, note: str | None = None) -> str:
    """The line with the rated torque of this reducer; unchanged where none is known.

    Args:
        path: names of the table and the key.
        match: of the line.
        torque: rated torque, N m.
        note: of its comment; None: as it is.
    """
    if torque is None or not path[-1].endswith(("output_torque", "rated_torque")):
        return match[0]
    return stated(match, in_unit(torque, "N m"), match["note"] if note is None else note)
