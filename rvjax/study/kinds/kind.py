"""Description of a kind of reducer for studies and commands: everything that its record does not hold.

With it its scaling laws, and numbers that follow the ratio of a number to its value in the study. A number that the
study gives does not follow. Without scaling laws an optimum would buy stiffness that no bearing of its size has.
"""

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp

from rvjax.catalogue import BASES
from rvjax.records import Design, PyTree, Record, Scalar
from rvjax.study.kinds.features import Feature
from rvjax.study.values import Toml

Follow = Callable[[PyTree, Mapping[str, Scalar], Mapping[str, PyTree], Collection[str]], Mapping[str, PyTree]]


def _none(*_: object) -> Any:
    """No lines and no numbers."""
    return []


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
    """

    name: str
    numbers: tuple[str, ...]
    follows: Mapping[str, float]
    interval: tuple[float, float]
    source: str
    whole: bool = False
    exact: bool = False


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
    others: Follow = _none
    bound: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    instead: Mapping[str, str] = field(default_factory=dict)

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
            used = (similar or law.exact) and (whole or not law.whole)
            ratios = {p: new[p] / number_at(design, p) for p in law.follows if used and new.get(p) is not None}
            for path in law.numbers if ratios else ():
                own = number_at(design, path)
                if path not in stands and own is not None:
                    new[path] = own * math.prod(ratio ** law.follows[p] for p, ratio in ratios.items())
        return _replaced(design, new | dict(self.others(design, values, new, stands)))

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
            if law.whole or not moving & set(law.follows):
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


def _replaced(record: Record, changes: Mapping[str, object]) -> PyTree:
    """A record of records with numbers replaced, by path: every record is checked once, with all its new numbers."""
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
    return record.replace(**own, **{name: _replaced(getattr(record, name), inner) for name, inner in parts.items()})


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


Numbers = Mapping[str, PyTree]
"""Numbers of a design by path, SI."""


@dataclass(frozen=True)
class Assumed:
    """A number that no source gives.

    Attributes:
        value: SI, or a count.
        why: where it comes from.
        outside: the numbers that lie outside the interval of its scaling law, a line each.
    """

    value: PyTree
    why: str
    outside: tuple[str, ...] = ()


@dataclass(frozen=True)
class Known:
    """The reducer of a new study, as its source gives it.

    Attributes:
        name: of the known reducer, or of the file of the drawing.
        kind: of the design.
        numbers: given ones by path, SI.
        said: further comment of a number by its path, such as "assumed".
        torque: rated torque, N m, with its reason; None: of no catalogue.
        drawing: the numbers are those of a file.
        unread: tables of the file that are not taken over.
    """

    name: str
    kind: "Kind"
    numbers: Numbers
    said: Mapping[str, str]
    torque: Assumed | None
    drawing: bool = False
    unread: tuple[str, ...] = ()


def _nothing(*_: object) -> None:
    """Nothing."""


def _no_text(*_: object) -> str:
    """No text."""
    return ""


def _first(*given: object) -> Any:
    """The first argument, unchanged."""
    return given[0]


def _as_given(*given: Any) -> tuple[Numbers, dict[str, Assumed]]:
    """The numbers of the source, and no others."""
    return given[0].numbers, {}


HEAD = (
    "# A study to change, with the numbers of the {name}: replace them by those of your drawing, then run\n"
    "# rvjax check on this file. Tolerances, costs and limits are assumed.\n\n"
)


@dataclass(frozen=True)
class Start:
    """A new study of one model, as `rvjax init` writes it.

    Attributes:
        study: embedded study with the tables after [design].
        parts: tables of [design] that the model reads.
        head: comment at the top; {name} is the reducer.
        complete: (reducer as its source gives it, design of the embedded study) -> (numbers that are taken over,
            numbers that the source lacks, by path).
        tables: (text of the tables after [design], all numbers, rated torque) -> this text for the reducer.
        unread: numbers -> comment on what the model does not read of a reducer that contradicts itself.
    """

    study: str
    parts: tuple[str, ...] = ()
    head: str = HEAD
    complete: Callable[[Known, Any], tuple[Numbers, Mapping[str, Assumed]]] = _as_given
    tables: Callable[[str, Numbers, Assumed | None], str] = _first
    unread: Callable[[Numbers], str] = _no_text


@dataclass(frozen=True)
class Drawing:
    """Drawings of a design, to scale.

    Attributes:
        reducer: design -> axes.
        caption: design -> title of the drawing on a page.
        compared: (design before, design after) -> axes.
        comparison: title of the drawing of two designs.
    """

    reducer: Callable[[Any], Any]
    caption: Callable[[Any], str]
    compared: Callable[[Any, Any], Any]
    comparison: str


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of reducer. Class and name are required; by default the other attributes add nothing to the record.

    Attributes:
        design: class of its designs; `catalogue.BASES` has the known ones.
        name: in messages, with its article.
        facts: design -> (name, value) of what follows from its numbers.
        derivation: (design, path, value) -> how this value follows from other numbers; "" where it does not.
        derived_from: paths of the numbers that derivations read or give.
        followed: (design, table [design] of its study) -> the design with what follows; ValueError: a contradiction.
        implied: numbers -> paths that a study need not give, because their values follow from the others.
        following: what follows a number that changes.
        refuse: design -> None; raises ValueError, one line, for parts that do not fit together.
        doubts: design -> lines on numbers that no known reducer has.
        coarse: (design, conditions, outputs) -> lines on angles that are too few for some outputs.
        inaccurate: (design, tolerances) -> lines on errors of the results, which every result prints.
        rated: rated torque of known reducers by name, N m.
        speed: largest speed of the output of known reducers, rad/s.
        of_another_size: (design, torque) -> line on a rated torque that belongs to a reducer of another size, or "".
        orders: design -> {part: order of the output revolution}; None where no bench measures its curve.
        multiples: design -> numbers of which every order of one part is a multiple; empty: any order may be one.
        unit_errors: `rvjax.mounting.unit_errors` or its like; None where no parts are matched.
        drawing: to scale; None: no drawing.
        starts: new studies by model, the usual one first.
        needed: paths of the numbers that a file must give where `rvjax init` begins with it; empty: with known
            reducers only.
        torque: numbers -> rated torque, N m, where such a file gives none.
        features: of the parts, by the error that belongs to each.
    """

    design: type
    name: str
    facts: Callable[[Any], Iterable[tuple[str, str]]] = _none
    derivation: Callable[[Any, str, Any], str] = _no_text
    derived_from: frozenset[str] = frozenset()
    followed: Callable[[Any, Toml], Any] = _first
    implied: Callable[[Numbers], Collection[str]] = _none
    following: Following = field(default_factory=Following)
    refuse: Callable[[Any], None] = _nothing
    doubts: Callable[[Any], list[str]] = _none
    coarse: Callable[[Any, Any, Collection[str]], list[str]] = _none
    inaccurate: Callable[[Any, Any], list[str]] = _none
    rated: Mapping[str, float] = field(default_factory=dict)
    speed: float = math.inf
    of_another_size: Callable[[Any, float], str] = _no_text
    orders: Callable[[Any], Mapping[str, float]] | None = None
    multiples: Callable[[Any], Sequence[int]] = _none
    unit_errors: Callable[..., Any] | None = None
    drawing: Drawing | None = None
    starts: Mapping[str, Start] = field(default_factory=dict)
    needed: tuple[str, ...] = ()
    torque: Callable[[Numbers], Assumed | None] = _nothing
    features: Mapping[str, Feature] = field(default_factory=dict)

    @property
    def word(self) -> str:
        """Its name in study files."""
        return str(self.design.kind)  # type: ignore[attr-defined]

    @property
    def plural(self) -> str:
        """Name of several, without an article."""
        return f"{self.name.partition(' ')[2]}s"

    @property
    def bases(self) -> dict[str, PyTree]:
        """Known designs by the name that study files give them."""
        return {name: design for name, design in BASES.items() if type(design) is self.design}

    @property
    def largest_torque(self) -> float:
        """Largest rated torque of known reducers, N m; infinite where none is known."""
        return max(self.rated.values(), default=math.inf)
