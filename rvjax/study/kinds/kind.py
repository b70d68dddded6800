"""Description of a kind of reducer for studies and commands: everything that its record does not hold.

Features of the parts that errors belong to are in `features.toml`: how a deviation becomes a size of a drawing.
"""

import importlib
import math
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from typing import Any

from rvjax.catalogue import BASES
from rvjax.geometry import figures
from rvjax.records import PyTree
from rvjax.study.kinds.scaling import Following, number_at
from rvjax.study.values import Toml, in_unit


def _none(*_: object) -> Any:
    """No lines and no numbers."""
    return []


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
        base: known reducer that the numbers begin with; "" for none.
        kind: of the design.
        numbers: given ones by path, SI.
        said: further comment of a number by its path, such as "assumed".
        torque: rated torque, N m, with its reason; None: of no catalogue.
        drawing: the numbers are those of a file.
        unread: tables of the file that are not taken over.
        process: that makes the parts; "" for the usual one.
        stated: paths of the numbers that the file itself gives.
    """

    name: str
    base: str
    kind: "Kind"
    numbers: Numbers
    said: Mapping[str, str]
    torque: Assumed | None
    drawing: bool = False
    unread: tuple[str, ...] = ()
    process: str = ""
    stated: frozenset[str] = frozenset()


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
class Choices:
    """Numbers that `rvjax design` may choose in a new study, lengths in proportion to those at the start; all assumed.

    Attributes:
        bounds: (lower, upper) over the number at the start, by path.
        prices: of the number at the start, by path.
        volume: price of the envelope at the start; 0: it has none.
        limits: of figures of the unit without errors over those at the start, below 1 lower and above 1 upper ones.
    """

    bounds: Mapping[str, tuple[float, float]]
    prices: Mapping[str, float] = field(default_factory=dict)
    volume: float = 0.0
    limits: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Start:
    """A new study of one model, as `rvjax init` writes it.

    Attributes:
        study: embedded study with the tables after [design].
        parts: tables of [design] that the model reads.
        head: comment at the top; {name} is the reducer.
        complete: (reducer as its source gives it, design of the embedded study) -> (numbers that are taken over,
            numbers that the source lacks, by path).
        tables: (text of the tables after [design], all numbers, reducer) -> this text for the reducer.
        unread: numbers -> comment on what the model does not read of a reducer that contradicts itself.
        choices: numbers that `rvjax design` may choose; None: not for this model.
    """

    study: str
    parts: tuple[str, ...] = ()
    head: str = HEAD
    complete: Callable[[Known, Any], tuple[Numbers, Mapping[str, Assumed]]] = _as_given
    tables: Callable[[str, Numbers, Known], str] = _first
    unread: Callable[[Numbers], str] = _no_text
    choices: Choices | None = None


def drawn(place: str) -> Callable[..., Any]:
    """A function of `rvjax.plotting` by its module and name, imported when it is called, as it needs Matplotlib."""
    module, _, name = place.partition(".")

    def draw(*designs: object) -> object:
        return getattr(importlib.import_module(f"rvjax.plotting.{module}"), name)(*designs)

    return draw


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


@dataclass(frozen=True)
class Feature:
    """Feature of a part that an error belongs to.

    Attributes:
        part: its name.
        feature: of one part.
        each: axis of equal parts, "" for one part.
        count: axes of equal features of one part.
        nominal: {path of a number of the design: its factor} whose sum is the nominal, m; empty if it is not known.
        factor: size over error, 2 for the radius of a diameter.
        form: "position", "runout" or "cumulative": form of a drawing for its zone; "" for limits.
        geometric: characteristic, "" for a size, or for that of the form.
        datum: of a geometric tolerance.
    """

    part: str
    feature: str
    each: str = ""
    count: tuple[str, ...] = ()
    nominal: Mapping[str, float] = field(default_factory=dict)
    factor: float = 1.0
    form: str = ""
    geometric: str = ""
    datum: str = ""

    @property
    def size(self) -> frozenset[str]:
        """Numbers of the design, the same for all errors of one size."""
        return frozenset(self.nominal)


def features(*tables: str) -> dict[str, Feature]:
    """Features by error.

    Args:
        *tables: of `features.toml`.
    """
    found = tomllib.loads((resources.files("rvjax.study.kinds") / "features.toml").read_text("utf-8"))
    return {error: Feature(**row) for table in tables for error, row in found[table].items()}


@dataclass(frozen=True, eq=False)
class Kind:
    """A kind of reducer. Class and name are required; by default the other attributes add nothing to the record.

    Attributes:
        design: class of its designs; `catalogue.BASES` has the known ones.
        name: in messages, with its article.
        facts: design -> (name, value) of what follows from its numbers.
        derivation: (design, path, value) -> how this value follows from other numbers; "" where it does not.
        derived_from: paths of the numbers that derivations read or give.
        followed: (design, table [design] of its study) -> the design, with what follows from the numbers given there;
            raises ValueError where they contradict each other.
        implied: numbers -> paths that a study need not give, because their values follow from the others.
        following: what follows a number that changes.
        refuse: design -> None; raises ValueError, one line, for parts that do not fit together.
        doubts: design -> lines on numbers that no known reducer has.
        coarse: (design, conditions, outputs) -> lines on angles that are too few for some outputs.
        inaccurate: (design, tolerances) -> lines on errors of the results, which every result prints.
        remedies: paths of numbers of which `rvjax check` may name one that would meet a missed limit.
        usual: outputs that `rvjax check` prints of the unit at the mid-points next to the required ones.
        turning: (design, tolerances, least clearance of random units) -> lines on the share that jams, and on the
            clearances with which 99 % turn; None: no unit of this kind jams.
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
        torque: reducer -> rated torque, N m, where its file gives none.
        processes: that make the parts of a new study; empty: tolerances follow the size alone.
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
    remedies: tuple[str, ...] = ()
    usual: tuple[str, ...] = ()
    turning: Callable[[Any, Any, Any], list[str]] | None = None
    rated: Mapping[str, float] = field(default_factory=dict)
    speed: float = math.inf
    of_another_size: Callable[[Any, float], str] = _no_text
    orders: Callable[[Any], Mapping[str, float]] | None = None
    multiples: Callable[[Any], Sequence[int]] = _none
    unit_errors: Callable[..., Any] | None = None
    drawing: Drawing | None = None
    starts: Mapping[str, Start] = field(default_factory=dict)
    needed: tuple[str, ...] = ()
    torque: Callable[[Known], Assumed | None] = _nothing
    processes: tuple[str, ...] = ()
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


def variable_tables(choices: Choices, design: PyTree) -> tuple[str, str]:
    """Tables of the numbers that `rvjax design` may choose, with their prices; limits of the unit without errors.

    Args:
        choices: of the kind of reducer.
        design: at the start.
    """
    tables = ["# Numbers of the design that may change; bounds and prices are assumed", ""]
    for path, shares in choices.bounds.items():
        if number := float(number_at(design, path)):  # 0 has no bounds in proportion
            lower, upper = (in_unit(end, "m") for end in sorted(share * number for share in shares))
            tables += [f'[variable."{path}"]', f'lower = "{lower}"', f'upper = "{upper}"']
            if price := choices.prices.get(path):
                tables += [f'cost = {{price = {price:g}, per = "{in_unit(number, "m")}"}}']
            tables += [""]
    limits = list[str]()
    found: PyTree = figures(design) if choices.volume or choices.limits else None
    if choices.volume:
        volume = in_unit(float(found.envelope_volume), "m3", 2)
        tables += ["[objective] # price of the space, in the unit of the costs"]
        tables += [f'envelope_volume = {{price = {choices.volume:g}, per = "{volume}"}}', ""]
        limits += ["# Limits of the unit without errors, assumed from its values at the start", ""]
    for name, share in choices.limits.items():
        value = in_unit(share * float(getattr(found, name)), "m", 3)
        limits += [f"[requirement.{name}]", f'nominal_{"lower" if share < 1 else "upper"} = "{value}"', ""]
    return "\n".join(tables), "\n".join(limits)
