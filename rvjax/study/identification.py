"""Table [identify] of a study: model, unknown values, noise of the bench.

The prior is the tolerances of the study; unknown values of the design and nuisances of the bench are added.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rvjax import models
from rvjax.measured import DIRECTIONS, KINDS, Kind
from rvjax.outputs import Observation
from rvjax.records import Design, PyTree
from rvjax.study.bench import number_of_design
from rvjax.study.nuisances import DRAGS, NUISANCES, nuisance
from rvjax.study.toleranced import parse_tolerance
from rvjax.study.values import Toml, choice, integer, known, naming_field, quantity, subtable
from rvjax.tolerances import Tolerance

KEYS = ("model", "orders", "noise", "nuisance", "shared", "unknown", "torques", "directions")
HEADLESS = "; the deformed housing is modelled for RV reducers only; an eccentric scale is the nuisance 'mounting'"
FINEST = 10_000
"""Highest order of the output revolution that a study may use."""


@dataclass(frozen=True)
class Identification:
    """Content of the table [identify].

    Attributes:
        model: one that a bench can measure, such as "four_bar".
        orders: of the output turn, ascending; empty for what has none.
        noise: standard deviation of one real number of the observation, rad or Hz; None: the floor of the data.
        nuisance: names of fields without interest.
        shared: names of fields that all units have in common.
        unknown: {number of the design: its prior}.
        torques: of planned runs and of candidates for the next one, N m.
        directions: of the same.
        columns: foreign names of the columns of the data.
    """

    model: str
    orders: tuple[int, ...] = ()
    noise: float | None = None
    nuisance: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    unknown: dict[str, Tolerance] = dataclasses.field(default_factory=dict)
    torques: tuple[float, ...] = ()
    directions: tuple[str, ...] = tuple(DIRECTIONS)
    columns: Toml = dataclasses.field(default_factory=dict)

    def prior(self, tolerances: PyTree) -> dict[str, Tolerance]:
        """All fields of the values of a unit: errors that vary, unknown numbers, nuisances of the bench."""
        names = [f.name for f in dataclasses.fields(tolerances)]
        errors = {n: getattr(tolerances, n) for n in names if isinstance(getattr(tolerances, n), Tolerance)}
        bench = {name: nuisance(name, self.orders) for name in self.nuisance if name in NUISANCES}
        return errors | self.unknown | bench


def parse_identification(
    table: Toml, columns: Toml, design: PyTree, tolerances: PyTree, folder: Path
) -> Identification:
    """Read the table [identify].

    Args:
        table: as written.
        columns: the table [columns].
        design: the reducer.
        tolerances: of its errors.
        folder: that files named in the study are relative to.

    Raises:
        ValueError: one line that names the key, its value and the unit.
    """
    known(table, KEYS, "identify")
    kind = models.kind(design)
    if not kind.observed:
        raise ValueError(f"[identify]: no model of a design of kind {type(design).kind!r} can be measured")
    model = choice(table.get("model"), kind.observed, "identify.model")
    observations = kind.observations(model)
    _check_parts(model, observations, design)
    orders = tuple(sorted(integer(k, "identify.orders", 1, FINEST) for k in _list(table, "orders")))
    if len(set(orders)) < len(orders):
        raise ValueError(f"identify.orders = {table['orders']!r}: names an order twice")
    if list(observations) == ["curve"] and not orders:
        raise ValueError("identify.orders is missing: orders of the output turn, such as [40, 80]")
    unknown, given = {}, subtable(table, "unknown")
    for name in given:
        where = f"identify.unknown.{name}"
        if name in {f.name for f in dataclasses.fields(design.error_record)}:
            raise ValueError(f"{where}: an error of the parts; write its limits in [tolerances.{name}]")
        with naming_field(where):
            unit = number_of_design(design, name)[1]
            unknown[name] = parse_tolerance(subtable(given, name), unit, where, folder)
    fields = [f.name for f in dataclasses.fields(tolerances) if isinstance(getattr(tolerances, f.name), Tolerance)]
    own = [*fields, *unknown]
    nuisances = tuple(choice(name, [*NUISANCES, *own], "identify.nuisance") for name in _list(table, "nuisance"))
    bench = [name for name in nuisances if name in NUISANCES]
    data = KINDS[planned_kind(observations, orders)]
    for name in bench:
        has = name != "reading" or any(seen.head for seen in observations.values())
        has = has and (name not in DRAGS or any(seen.sided for seen in observations.values()))
        if name not in data.nuisances or not has:
            why = HEADLESS if name == "reading" and model == "loaded" else ""  # of another kind than an RV reducer
            raise ValueError(f"identify.nuisance = {name!r}: no observation of model {model!r} has it{why}")
    shared = tuple(choice(name, own, "identify.shared") for name in _list(table, "shared"))
    torques = tuple(quantity(t, "N m", "identify.torques") for t in _list(table, "torques"))
    directions = tuple(choice(d, DIRECTIONS, "identify.directions") for d in _list(table, "directions")) or tuple(
        DIRECTIONS
    )
    return Identification(
        model=model,
        orders=orders,
        noise=_noise(table, data),
        nuisance=nuisances,
        shared=shared,
        unknown=unknown,
        torques=torques,
        directions=directions,
        columns=columns,
    )


def _list(table: Mapping[str, object], key: str) -> list[object]:
    value = table.get(key, [])
    if not isinstance(value, list):
        raise ValueError(f"identify.{key} = {value!r}: must be a list")
    return value


def planned_kind(observations: Mapping[str, Observation], orders: tuple[int, ...]) -> str:
    """Kind of the data that a study plans: a curve where it names orders, else the last of the model.

    Args:
        observations: of the model, by kind.
        orders: of the study.
    """
    return "curve" if orders and "curve" in observations else list(observations)[-1]


def _noise(table: Mapping[str, object], data: Kind) -> float | None:
    given = table.get("noise")
    if given is None:
        raise ValueError(
            f'identify.noise is missing: "floor", or the standard deviation of a reading, such as "{data.example}"'
        )
    if given == "floor":
        return None
    noise = quantity(given, data.unit, "identify.noise")
    if noise <= 0:
        raise ValueError(f"identify.noise = {given!r}: must be positive")
    return noise


def _check_parts(model: str, observations: Mapping[str, Observation], design: object) -> None:
    needs = dict.fromkeys(part for observation in observations.values() for part in observation.needs)
    missing = [part for part in needs if getattr(design, part) is None]
    if missing:
        raise ValueError(f"identify.model = {model!r}: the design has no {' and no '.join(missing)}")


def field_unit(design: Design, name: str) -> str:
    """SI unit of a field of the values of a unit: an error, an unknown number or a nuisance.

    Args:
        design: of the unit.
        name: of the field.
    """
    units = {f.name: f.metadata["unit"] for f in dataclasses.fields(design.error_record)}
    if name in NUISANCES:
        return DRAGS[name][0] if name in DRAGS else "rad"
    return units[name] if name in units else number_of_design(design, name)[1]
