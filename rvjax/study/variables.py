"""Tables [variable] and [objective]: numbers of the design that an optimum may choose, and prices of outputs."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import jax.numpy as jnp

from rvjax.base.words import unknown
from rvjax.outputs import Output
from rvjax.records import Design
from rvjax.study.kinds import fields_of, kind_of, number_at, split
from rvjax.study.values import Toml, choice, known, naming_field, quantity, subtable
from rvjax.tolerances import Variable
from rvjax.units import with_unit


def refuse_variable(design: Design, path: str, given: Collection[str]) -> None:
    """Raise an error for a path that cannot be a variable.

    Args:
        design: the reducer.
        path: as written.
        given: paths of numbers that the study gives.

    Raises:
        ValueError: one line.
    """
    names, element = split(path)
    plain, own = ".".join(names), number_at(design, ".".join(names))
    following = kind_of(design).following
    known = dict(fields_of(design))
    if plain not in known:
        raise unknown(f"variable.{path}: unknown number of the design", plain, sorted(known), "; known here:")
    if known[plain]["kind"] == "count":
        raise ValueError(f"variable.{path}: is an integer, {own}; write a study for each value")
    if plain in following.instead:
        raise ValueError(f"variable.{path}: follows from {following.instead[plain]}")
    if own is None:
        raise ValueError(f"variable.{path}: [design] has no {plain}; give its value at the start there")
    if (size := jnp.shape(own)) and (element is None or element >= size[0] or len(size) > 1):
        raise ValueError(f"variable.{path}: name one element, {plain}[0] to {plain}[{size[0] - 1}]")
    if element is not None and not size:
        raise ValueError(f"variable.{path}: is one number; leave [{element}] out")
    if held := [name for name in following.bound.get(plain, ()) if name in given]:
        raise ValueError(f"variable.{path}: design.{held[0]} is given, but follows it; leave it out of [design]")


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
            said = repr(entry["start"]) if "start" in entry else f"{with_unit(start, unit, '.6g')}, that of [design],"
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
