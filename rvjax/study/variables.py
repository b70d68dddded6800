"""Tables [variable] and [objective]: numbers of the design that an optimum may choose, and prices of outputs.

Scaling laws: numbers of a design that follow a number that changes (`scaling.toml`).

The ratio of a number to its value in the study gives the ratio of the numbers that follow. A number that the study
gives does not follow. Without scaling laws an optimum would buy stiffness that no bearing of its size has.
"""

import dataclasses
import math
import re
import tomllib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from importlib import resources

import jax.numpy as jnp

from rvjax._ground.choices import unknown
from rvjax.designs import RVReducer
from rvjax.outputs import Output
from rvjax.records import Design, PyTree, Scalar
from rvjax.study.values import Toml, choice, known, naming_field, quantity, subtable
from rvjax.tolerances import Variable

_FILE: dict[str, PyTree] = tomllib.loads((resources.files("rvjax.study") / "scaling.toml").read_text("utf-8"))
ANGLE = "involute.pressure_angle"
BASE_RADII = ("involute.sun_base_radius", "involute.planet_base_radius")
PROFILE = ("cycloid.eccentricity", "cycloid.pin_circle_radius")  # the shortening coefficient follows


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
    """

    name: str
    numbers: tuple[str, ...]
    follows: Mapping[str, float]
    interval: tuple[float, float]
    source: str
    whole: bool = False


OF_A_SIZE = tuple(
    Law(
        entry["name"],
        tuple(entry["numbers"]),
        {_FILE["numbers"][key]: float(power) for key, power in entry["follows"].items()},
        (float(entry["interval"][0]), float(entry["interval"][1])),
        entry["source"],
        entry.get("whole", False),
    )
    for entry in _FILE["law"]
)
"""Ordered: a number that follows comes before the numbers that follow it."""
LAWS = tuple(law for law in OF_A_SIZE if not law.whole)
NAMES: dict[str, str] = {path: name for name, path in _FILE["numbers"].items()}
"""Short names of the numbers that scaling laws read, by their path."""
SIZES: tuple[dict[str, PyTree], ...] = tuple(_FILE["tolerance"])
"""Sizes that tolerances belong to."""

GEARS = LAWS[0]  # kinematics: gears that do not obey it do not mesh
AXIAL = next(law for law in LAWS if "bearings.disc_position" in law.numbers)  # discs of another width have other places


def number_at(design: object, path: str) -> PyTree:
    """Number of a design by its path, such as "cycloid.profile_modification[1]"; None where a part is missing."""
    names, element = _split(path)
    for name in names:
        design = getattr(design, name, None)
    return design if element is None or design is None else jnp.asarray(design)[element]


def _split(path: str) -> tuple[list[str], int | None]:
    found = re.fullmatch(r"([\w.]+)(?:\[(\d+)\])?", path)
    if found is None:
        raise ValueError(f"{path}: must be a path in the design, such as cycloid.eccentricity")
    return found[1].split("."), None if found[2] is None else int(found[2])


def _replaced(record: PyTree, changes: Mapping[str, PyTree]) -> PyTree:
    """A record of records with numbers replaced, by path: every record is checked once, with all its new numbers."""
    own: dict[str, PyTree] = {}
    parts: dict[str, dict[str, PyTree]] = {}
    for path, value in changes.items():
        name, _, rest = path.partition(".")
        names, element = _split(name)
        if rest:
            parts.setdefault(name, {})[rest] = value
        elif element is not None:
            own[names[0]] = jnp.asarray(own.get(names[0], getattr(record, names[0]))).at[element].set(value)
        else:
            own[name] = value
    return record.replace(**own, **{name: _replaced(getattr(record, name), inner) for name, inner in parts.items()})


def changed(
    design: PyTree,
    values: Mapping[str, Scalar],
    given: Collection[str] = (),
    *,
    similar: bool = True,
    whole: bool = False,
) -> PyTree:
    """The design with other numbers, and with all that follows.

    Args:
        design: before.
        values: {path: new value}, SI; they may be traced.
        given: paths of numbers that the study gives: they do not follow.
        similar: False: without scaling laws; only gears, crank circle and K1 follow.
        whole: a reducer of another size; also with the scaling laws that hold only there.
    """
    stands, new = {*values, *given}, dict[str, PyTree](values)
    if not isinstance(design, RVReducer):
        return _replaced(design, new)
    if set(PROFILE) & set(values) and "cycloid.shortening" not in stands:
        new["cycloid.shortening"] = None
    for law in (OF_A_SIZE if whole else LAWS) if similar else (GEARS,):
        ratios = {p: new[p] / number_at(design, p) for p in law.follows if new.get(p) is not None}
        for path in law.numbers if ratios else ():
            own = number_at(design, path)
            if path not in stands and own is not None:
                new[path] = own * math.prod(ratio ** law.follows[p] for p, ratio in ratios.items())
    if ANGLE in values:
        ratio = jnp.cos(values[ANGLE]) / jnp.cos(design.involute.pressure_angle)
        for path in (path for path in BASE_RADII if path not in stands):
            new[path] = (new[path] if path in new else number_at(design, path)) * ratio
    return _replaced(design, new)


def laws_of(design: Design, paths: Collection[str], given: Collection[str] = ()) -> list[tuple[Law, list[str]]]:
    """Scaling laws that changes of some numbers call, each with the numbers of the design that follow.

    Args:
        design: the reducer.
        paths: of the numbers that change.
        given: paths of numbers that the study gives: they do not follow.
    """
    moving, found = set(paths), []
    for law in LAWS if isinstance(design, RVReducer) else ():
        if not moving & set(law.follows):
            continue
        numbers = [path for path in law.numbers if path not in {*paths, *given} and _there(design, path)]
        moving |= set(numbers)
        if numbers:
            found.append((law, numbers))
    return found


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


def refuse_variable(design: Design, path: str, given: Collection[str]) -> None:
    """Raise an error for a path that cannot be a variable.

    Args:
        design: the reducer.
        path: as written.
        given: paths of numbers that the study gives.

    Raises:
        ValueError: one line.
    """
    names, element = _split(path)
    plain, own = ".".join(names), number_at(design, ".".join(names))
    known = dict(fields_of(design))
    if plain not in known:
        raise unknown(f"variable.{path}: unknown number of the design", plain, sorted(known), "; known here:")
    if known[plain]["kind"] == "count":
        raise ValueError(f"variable.{path}: is an integer, {own}; write a study for each value")
    if plain in GEARS.numbers:
        raise ValueError(f"variable.{path}: follows from involute.module; vary that one")
    if plain == "cycloid.shortening":
        raise ValueError(f"variable.{path}: follows from eccentricity and pin circle radius; vary these")
    if own is None:
        raise ValueError(f"variable.{path}: [design] has no {plain}; give its value at the start there")
    if (size := jnp.shape(own)) and (element is None or element >= size[0] or len(size) > 1):
        raise ValueError(f"variable.{path}: name one element, {plain}[0] to {plain}[{size[0] - 1}]")
    if element is not None and not size:
        raise ValueError(f"variable.{path}: is one number; leave [{element}] out")
    followers = [*(GEARS.numbers if plain in GEARS.follows else ()), *(BASE_RADII if plain == ANGLE else ())]
    followers += ["cycloid.shortening"] if plain in PROFILE else []
    followers += AXIAL.numbers if plain in AXIAL.follows else ()
    if held := [name for name in followers if name in given]:
        raise ValueError(f"variable.{path}: design.{held[0]} is given, but follows it; leave it out of [design]")


def fields_of(record: PyTree, prefix: str = "") -> Iterator[tuple[str, Mapping[str, PyTree]]]:
    """(path, metadata) of every number of a design, also of those without a value."""
    for f in dataclasses.fields(record):
        value, about = getattr(record, f.name), f.metadata
        if about["kind"] == "record":
            yield from fields_of(value, f"{prefix}{f.name}.") if value is not None else ()
        else:
            yield prefix + f.name, about


KEYS = ("lower", "upper", "start", "among", "cost")


@dataclass(frozen=True)
class Price:
    """Price of a quantity, in proportion.

    Attributes:
        price: of one unit.
        per: the unit of the price, SI.
    """

    price: float
    per: float

    def __call__(self, value: float) -> float:
        """Price of a value, SI."""
        return self.price * value / self.per


def parse_variables(table: Toml, design: Design, given: Collection[str]) -> dict[str, Variable]:
    """The table [variable] as variables by the path of their number.

    Args:
        table: as written.
        design: of the study, whose number is the start where none is given.
        given: paths of the numbers that the study gives.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    found = {}
    for path in table:
        where, entry = f'variable."{path}"', subtable(table, path)
        refuse_variable(design, path, given)
        known(entry, KEYS, where)
        unit = str(dict(fields_of(design))[path.partition("[")[0]]["unit"])
        for key in ("lower", "upper"):
            if key not in entry:
                raise ValueError(f"{where}.{key} is missing: a variable lies between lower and upper, in {unit}")
        lower, upper = (quantity(entry[key], unit, f"{where}.{key}") for key in ("lower", "upper"))
        if lower > upper:
            raise ValueError(f"{where}.lower = {entry['lower']!r}: must not exceed upper = {entry['upper']!r}")
        start = quantity(entry["start"], unit, f"{where}.start") if "start" in entry else float(number_at(design, path))
        if not lower <= start <= upper:
            said = repr(entry["start"]) if "start" in entry else f"{start:.6g} {unit}, that of [design],"
            raise ValueError(f"{where}.start = {said}: must lie between lower and upper")
        among = _list(entry["among"], unit, f"{where}.among", lower, upper) if "among" in entry else ()
        cost = _price(entry["cost"], unit, f"{where}.cost") if "cost" in entry else None
        with naming_field(where):
            found[path] = Variable(lower, upper, start, cost=cost, among=among)
    return found


def _list(value: object, unit: str, where: str, lower: float, upper: float) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"{where} = {value!r}: must be a list of one or more values in {unit}")
    found = tuple(quantity(item, unit, where) for item in value)
    for item, number in zip(value, found):
        if not lower <= number <= upper:
            raise ValueError(f"{where} = {item!r}: must lie between lower and upper")
    return found


def _price(value: object, unit: str, where: str) -> Price:
    if not isinstance(value, dict):
        raise ValueError(f'{where} = {value!r}: must be a table such as {{price = 1.0, per = "1 {unit}"}}')
    known(value, ("price", "per"), where)
    for key in ("price", "per"):
        if key not in value:
            raise ValueError(f"{where}.{key} is missing: a price is for a quantity, in {unit}")
    price, per = quantity(value["price"], "-", f"{where}.price"), quantity(value["per"], unit, f"{where}.per")
    if per <= 0:
        raise ValueError(f"{where}.per = {value['per']!r}: must be positive")
    return Price(price, per)


def parse_objective(table: Toml, outputs: Mapping[str, Output]) -> dict[str, Price]:
    """The table [objective] as prices by output.

    Args:
        table: as written.
        outputs: of this kind of design, by name.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    found = {}
    for name, value in table.items():
        choice(name, outputs, f"objective.{name}: output")
        found[name] = _price(value, outputs[name].unit, f"objective.{name}")
    return found
