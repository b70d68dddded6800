"""Table [identify] of a study: model, unknown values, noise and nuisances of the bench.

The prior is the tolerances of the study; unknown values of the design are added, and nuisances: contributions to a
measurement that are not errors of parts.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rvjax import models
from rvjax.base.words import unknown
from rvjax.catalogue import fields_of
from rvjax.measured import DIRECTIONS, KINDS, Kind
from rvjax.outputs import Observation
from rvjax.records import Design, PyTree, Record
from rvjax.study.tolerances import by_error, parse_tolerance
from rvjax.study.values import Toml, choice, integer, known, naming_field, positive, quantity, subtable
from rvjax.tolerances import Tolerance
from rvjax.units import arcsec

KEYS = ("model", "orders", "noise", "nuisance", "shared", "unknown", "torques", "directions")
HEADLESS = "; the deformed housing is modelled for RV reducers only; an eccentric scale is the nuisance 'mounting'"
FINEST = 10_000
"""Highest order of the output revolution that a study may use."""
WIDE = 3000 * arcsec
NUISANCES: dict[str, str] = {
    "offset": "zero of the angle readings, one for all runs; with it the means of the runs count",
    "mounting": "eccentricity of the encoders, [cosine, sine] of order 1; with it order 1 counts",
    "phase": "angle of the index mark, where there is none",
    "reading": "motion of a head against the scale under load: oval ring, tilt, dent, each [cosine, sine] of the head",
    "drag": "friction torque at the output that opposes the motion, independent of speed",
    "viscous_drag": "friction torque at the output that opposes the motion, over the speed of the input",
}
DRAGS = {"drag": ("N m", 1000.0), "viscous_drag": ("N m s/rad", 10.0)}
"""Unit and half-width of the nuisances that are torques; the others are angles."""


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
    """

    model: str
    orders: tuple[int, ...] = ()
    noise: float | None = None
    nuisance: tuple[str, ...] = ()
    shared: tuple[str, ...] = ()
    unknown: dict[str, Tolerance] = dataclasses.field(default_factory=dict)
    torques: tuple[float, ...] = ()
    directions: tuple[str, ...] = tuple(DIRECTIONS)

    def prior(self, tolerances: Record) -> dict[str, Tolerance]:
        """All fields of the values of a unit: errors that vary, unknown numbers, nuisances of the bench."""
        bench = {name: nuisance(name, self.orders) for name in self.nuisance if name in NUISANCES}
        return by_error(tolerances) | self.unknown | bench


def parse_identification(table: Toml, design: PyTree, tolerances: Record, folder: Path) -> Identification:
    """Read the table [identify].

    Args:
        table: as written.
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
    own = [*by_error(tolerances), *unknown]
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
    chosen = _list(table, "directions") or DIRECTIONS
    directions = tuple(choice(direction, DIRECTIONS, "identify.directions") for direction in chosen)
    return Identification(
        model=model,
        orders=orders,
        noise=_noise(table, data),
        nuisance=nuisances,
        shared=shared,
        unknown=unknown,
        torques=torques,
        directions=directions,
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
    return positive(given, data.unit, "identify.noise")


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


def number_of_design(design: PyTree, name: str) -> tuple[str, str]:
    """Path and SI unit of a number of a design.

    Args:
        design: the reducer.
        name: of a field of one of its parts, with the part ("output.pin_stiffness") where several have it; "stiffness"
            is a factor on all its springs, whose path is empty.

    Raises:
        ValueError: no part has such a number, or several have it.
    """
    springs = hasattr(design, "stiffer")
    if name == "stiffness" and springs:
        return "", "-"
    traced = {path: about for path, about in fields_of(design) if about["kind"] not in ("count", "text")}
    units = {path: str(about["unit"]) for path, about in traced.items() if path.count(".") < 2}
    owners: dict[str, list[str]] = {}
    for path in units:
        owners.setdefault(path.rpartition(".")[2], []).append(path)
    if len(owners.get(name, [])) > 1:
        raise ValueError(f"{name}: several parts have it; write {' or '.join(map(repr, owners[name]))}")
    short = {number: whole[0] for number, whole in owners.items() if len(whole) == 1}
    paths = {path: path for path in units if path not in short.values()} | short
    if name not in paths:
        first = ["stiffness (a factor on all springs)"] if springs else []
        raise unknown("no number of this design", name, [*first, *paths], "; there are")
    return paths[name], units[paths[name]]


def nuisance(name: str, orders: Sequence[int]) -> Tolerance:
    """The prior of a nuisance of the bench.

    Args:
        name: of `NUISANCES`.
        orders: of the output turn that are measured; a phase is seen up to their common turn.
    """
    if name == "phase":
        half = math.pi / math.gcd(*orders)
        return Tolerance(-half, half, distribution="uniform")
    if name in DRAGS:
        return Tolerance.symmetric(DRAGS[name][1])
    shape = {"mounting": (2,), "reading": (6,)}.get(name, ())
    return Tolerance.symmetric(WIDE, shape=shape, vector=False) if shape else Tolerance.symmetric(WIDE)


def part_orders(design: Design, orders: Iterable[int]) -> tuple[int, ...]:
    """The orders that only errors of parts or the mounting of the scale make: no harmonic of the housing has them.

    With the ring at rest: |zp P - m| with P = m + c s is zc P + c s but for its sign (`loaded.housing_orders`), with c
    equal places where discs and carrier meet. With the carrier at rest: multiples of the pins.

    Args:
        design: the reducer; its places are equal.
        orders: of the output turn.
    """
    counts = getattr(design, "counts", {})
    common = math.gcd(counts.get("teeth", 1), counts.get(getattr(design, "places", ""), 1))
    if getattr(design, "member", "carrier") == "ring":
        common = counts["pins"]
    return tuple(order for order in orders if order % common)
