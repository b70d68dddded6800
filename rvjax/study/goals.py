"""Tables of goals and choices: limits and prices of outputs, costs and ranges of what an optimum may change."""

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import jax.numpy as jnp

from rvjax.base.words import unknown
from rvjax.catalogue import fields_of
from rvjax.outputs import Output
from rvjax.records import IN_ERROR_UNIT, Design, Record
from rvjax.study.kinds import kind_of, number_at, split
from rvjax.study.tolerances import by_error, metadata
from rvjax.study.values import (
    Toml,
    choice,
    known,
    naming_field,
    needed,
    positive,
    quantities,
    quantity,
    subtable,
)
from rvjax.tolerances import COSTS, KINDS, Cost, Limits, Middle, QuadraticLoss, Variable, check_middles
from rvjax.units import unit_of, with_unit


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
    variables = {}
    for path in table:
        where, entry = f'variable."{path}"', subtable(table, path)
        refuse_variable(design, path, given)
        known(entry, KEYS, where)
        unit = str(dict(fields_of(design))[path.partition("[")[0]]["unit"])
        needed(entry, ("lower", "upper"), where, f"a variable lies between lower and upper, in {unit}")
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
            variables[path] = Variable(lower, upper, start, cost=cost, among=among)
    return variables


def _list(value: object, unit: str, where: str, lower: float, upper: float) -> tuple[float, ...]:
    if not isinstance(value, list) or not value:
        raise ValueError(f"{where} = {value!r}: must be a list of one or more values in {unit}")
    numbers = tuple(quantity(item, unit, where) for item in value)
    for item, number in zip(value, numbers):
        if not lower <= number <= upper:
            raise ValueError(f"{where} = {item!r}: must lie between lower and upper")
    return numbers


def _price(value: object, unit: str, where: str) -> Price:
    if not isinstance(value, dict):
        raise ValueError(f'{where} = {value!r}: must be a table such as {{price = 1.0, per = "1 {unit}"}}')
    known(value, ("price", "per"), where)
    needed(value, ("price", "per"), where, f"a price is for a quantity, in {unit}")
    return Price(quantity(value["price"], "-", f"{where}.price"), positive(value["per"], unit, f"{where}.per"))


def parse_objective(table: Toml, outputs: Mapping[str, Output]) -> dict[str, Price]:
    """The table [objective] as prices by output.

    Args:
        table: as written.
        outputs: of this kind of design, by name.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    names = {name: choice(name, outputs, f"objective.{name}: output") for name in table}
    return {name: _price(table[name], outputs[name].unit, f"objective.{name}") for name in names}


def parse_costs(table: Toml, tolerances: Record) -> dict[str, Cost]:
    """The table [cost] as cost models by error.

    Args:
        table: as written.
        tolerances: of the study.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    costs: dict[str, Cost] = {}
    for field in table:
        where, entry = f"cost.{field}", dict(subtable(table, field))
        if field not in by_error(tolerances):
            raise ValueError(f"{where}: there is no [tolerances.{field}] for it")
        law = COSTS[choice(entry.pop("model", "reciprocal_power"), COSTS, f"{where}.model")]
        declared = {f.name: f for f in dataclasses.fields(law)}
        known(entry, declared, where)
        units = {name: f.metadata["unit"] for name, f in declared.items()}
        units |= {n: metadata(type(tolerances), field)["unit"] for n, unit in units.items() if unit == IN_ERROR_UNIT}
        for key, f in declared.items():
            if f.default is dataclasses.MISSING:
                needed(entry, [key], where, f"{f.metadata['meaning']}, in {units[key]}")
        with naming_field(where):
            costs[field] = law(**{key: quantities(value, units[key], f"{where}.{key}") for key, value in entry.items()})
    return costs


def parse_middles(table: Toml, tolerances: Record, variables: Collection[str]) -> dict[str, Middle]:
    """The table [middle] as ranges of mid-points by error.

    Args:
        table: as written.
        tolerances: of the study.
        variables: paths of the numbers of the design that may change.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    middles, active = {}, by_error(tolerances)
    for name in table:
        where, entry = f"middle.{name}", subtable(table, name)
        if name not in active:
            raise ValueError(f"{where}: there is no [tolerances.{name}] for it")
        unit = metadata(type(tolerances), name)["unit"]
        units = {"lower": unit, "upper": unit, "cost": "-", "per": unit}
        known(entry, units, where)
        keys = ("lower", "upper", "per") if "cost" in entry else ("lower", "upper")
        needed(entry, keys, where, f"a mid-point lies between lower and upper, in {unit}")
        values = {key: quantity(entry[key], units[key], f"{where}.{key}") for key in entry}
        per = positive(entry["per"], unit, f"{where}.per") if "per" in entry else 1.0
        with naming_field(where):
            middles[name] = Middle(values["lower"], values["upper"], values.get("cost", 0.0) / per)
            check_middles({name: middles[name]}, active)
    for path in variables:
        if (field := path.rpartition(".")[2]) in middles:
            raise ValueError(f'variable."{path}": [middle.{field}] moves the same number; give only one')
    return middles


def parse_accuracy(table: Toml, outputs: Mapping[str, Output], requirements: Collection[str]) -> dict[str, float]:
    """The table [accuracy] as largest errors of computation by response, SI.

    Args:
        table: as written.
        outputs: of this kind of design, by name.
        requirements: names of the responses.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    for name in table:
        choice(name, requirements, f"accuracy.{name}: response")
    return {name: positive(value, outputs[name].unit, f"accuracy.{name}") for name, value in table.items()}


def parse_losses(table: Toml, outputs: Mapping[str, Output]) -> dict[str, QuadraticLoss]:
    """The tables [loss.OUTPUT] as losses by output.

    Args:
        table: as written.
        outputs: of this kind of design, by name.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    losses = {}
    for name, entry in table.items():
        where, unit = f"loss.{name}", outputs[choice(name, outputs, f"loss.{name}: response")].unit
        if not isinstance(entry, dict):
            raise ValueError(f'{where} = {entry!r}: must be a table with price, at = "1 {unit}" and target')
        known(entry, ("price", "at", "target"), where)
        needed(entry, ("price", "at"), where, "a deviation of `at` from the target costs the price")
        price, at = quantity(entry["price"], "-", f"{where}.price"), positive(entry["at"], unit, f"{where}.at")
        if price < 0:
            raise ValueError(f"{where}.price = {entry['price']!r}: must not be negative")
        target = quantity(entry["target"], unit, f"{where}.target") if "target" in entry else 0.0
        losses[name] = QuadraticLoss(price, at, target)
    return losses


def _together(where: str, given: Toml) -> None:
    """Raise ValueError for keys of different kinds of requirements."""
    kinds = [kind for kind in KINDS if set(given) & set(kind.limit_keys())]
    if not kinds:
        return
    nearest = min(kinds, key=lambda kind: len(set(given) - set(kind.file_keys())))
    alien = next(key for key in given if key not in nearest.file_keys())
    own, ways = [key for key in given if key in nearest.file_keys()], ", ".join(nearest.file_keys())
    raise ValueError(
        f"{where}.{alien} = {given[alien]!r}: must not be given with {', '.join(own)}; "
        f"remove it (keys of such a requirement: {ways})"
    )


def parse_requirements(table: Toml, outputs: Mapping[str, Output]) -> tuple[dict[str, Limits], dict[str, str]]:
    """The table [requirement] as limits, and the unit of the first limit of each response.

    Args:
        table: as written.
        outputs: of this kind of design, by name.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    requirements: dict[str, Limits] = {}
    read_in: dict[str, str] = {}
    for name in table:
        where, entry = f"requirement.{name}", subtable(table, name)
        known(entry, {"response", *(key for kind in KINDS for key in kind.file_keys())}, where)
        response = choice(entry.get("response", name), outputs, f"{where}.response")
        if response in requirements:
            raise ValueError(f"{where}.response = {response!r}: already has a requirement")
        given = {key: value for key, value in entry.items() if key != "response"}
        unit = outputs[response].unit
        kinds = [kind for kind in KINDS if set(given) <= set(kind.file_keys()) and set(given) & set(kind.limit_keys())]
        if not kinds:
            _together(where, given)
            ways = "; or ".join(", ".join(kind.file_keys()) for kind in KINDS)
            raise ValueError(f"{where}: give upper or lower in {unit} (of these keys: {ways})")
        limits = kinds[0].limit_keys()
        values = {
            field: quantity(given[key], unit if key in limits else "-", f"{where}.{key}")
            for key, field in kinds[0].file_keys().items()
            if key in given
        }
        if {"lower", "upper"} <= set(values) and values["lower"] > values["upper"]:
            low, high = (f"{key} = {given[key]!r}" for key in limits)
            raise ValueError(f"{where}.{low}: must not lie above {high}")
        with naming_field(where):
            requirements[response] = kinds[0](**values)
        if unit != "-":  # limits are texts with units, they have been read before
            read_in[response] = unit_of(str(next(given[key] for key in given if key in limits)), unit)
    return requirements, read_in
