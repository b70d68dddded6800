"""Plausible designs: lengths, stiffnesses and inertias of known reducers, and a warning for a design far from all."""

import dataclasses
import functools
import math
import warnings
import weakref
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import jax
import numpy as np

from rvjax import catalogue
from rvjax._jax import checks
from rvjax._jax.programs import ONCE, quick
from rvjax._reducer import flank
from rvjax.records import PyTree, Scalar, concrete
from rvjax.units import rpm, suited, with_unit

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

P = ParamSpec("P")
R = TypeVar("R")

FAR = 30.0  # factor from every known reducer beyond which a number is doubted
FAR_STIFFNESS = 600.0  # in Python, where calibrations move it: less than the thousand between N/mm and N/m
STIFFNESS = ("N/m", "N m/rad")
FAR_INERTIA = 1000.0  # grows with the fifth power of a length: 50 between the sizes 20 and 320
KNOWN_DESIGNS = tuple(catalogue.BASES.values())


class ImplausibleDesign(UserWarning):
    """Design with values far from those of every known reducer; mostly a wrong unit."""


_seen: "dict[int, weakref.ref[object]]" = {}  # designs by identity: records of arrays have no hash


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """Check the arguments of a model as `checks.checked` does, and doubt its design."""
    return checks.checked(function, doubt_once)


def doubt_once(design: object, where: str) -> None:
    """Warn of a design whose lengths or stiffnesses are far from every known reducer, once for each; tracers pass.

    Calibrations move stiffnesses, so their range is wider than in studies. Only studies list inertias.

    Args:
        design: as given.
        where: the function, for the message.
    """
    known = _seen.get(id(design))
    new = known is None or known() is not design
    if not (new and type(design) in _spans() and accept(design)):
        return
    if found := steep(design) + doubtful(design, ("m",)) + doubtful(design, STIFFNESS, FAR_STIFFNESS):
        more = f" (and {len(found) - 1} more values)" if len(found) > 1 else ""
        warnings.warn(f"{where}: design.{found[0]}{more}", ImplausibleDesign, stacklevel=3)


def accept(design: object) -> bool:
    """Take note of a design, so that `doubt_once` does not warn of it; False for one of tracers, which is not noted.

    Args:
        design: such as a study has read and checked.
    """
    if not concrete(*jax.tree.leaves(design)):
        return False
    key = id(design)
    _seen[key] = weakref.ref(design, lambda _: _seen.pop(key, None))
    return True


def doubtful(design: PyTree, units: tuple[str, ...] = (), far: float = FAR) -> list[str]:
    """Values of a design that are far from those of every known reducer, a line each.

    Args:
        design: any; one of a class without known reducers gives none.
        units: of the values that are checked; all without one.
        far: factor from every known reducer beyond which a value is listed.
    """
    spans = _spans().get(type(design), {})
    return [
        line
        for name, (value, unit) in numbers(design)
        if value and name in spans and (not units or unit in units)
        for line in doubt(name, abs(value), unit, *spans[name], far=far)
    ]


def steep(design: PyTree) -> list[str]:
    """A line for harmonics of a profile modification that are too steep for models of first order, else nothing.

    Args:
        design: numbers, not traced.
    """
    cycloid = getattr(design, "cycloid", None)
    slope = 0.0 if cycloid is None else flank.steepest(cycloid)
    if slope <= 1.001 * flank.STEEPEST:  # optima are at the limit
        return []
    found = "the flank is undercut" if math.isnan(slope) else f"slope of the flank {slope:.2g}"
    return [f"cycloid.profile_modification: {found}; the models are of first order, up to a slope of {flank.STEEPEST}"]


@quick(options=ONCE)  # one program instead of one for each operation
def _room(cycloid: PyTree) -> jax.Array:
    return flank.Ground.of(cycloid).least_convex(cycloid.pin_count)


def sharp_from(cycloid: PyTree) -> float:
    """Pin radius from which on the flank of a disc with these modifications is undercut, m; <= 0: with all pins.

    Args:
        cycloid: numbers, not traced.
    """
    return float(cycloid.pin_radius) + float(_room(cycloid))


def undercut(design: PyTree) -> list[str]:
    """A line for pins that cut into the flank of the discs, else nothing.

    Args:
        design: numbers, not traced.
    """
    cycloid = getattr(design, "cycloid", None)
    if cycloid is None or cycloid.pin_radius < (least := sharp_from(cycloid)):
        return []
    limit = f"from {shown(least, 'm')} on" if least > 0 else "of any radius"
    found = f"pins {limit} cut into the flank of the discs (undercut)"
    return [f"cycloid.pin_radius = {shown(cycloid.pin_radius, 'm')}: {found}"]


@functools.cache
def _spans() -> dict[type, dict[str, tuple[float, float]]]:
    """Smallest and largest value of each quantity in known reducers, by class of the design."""
    found: dict[type, dict[str, tuple[float, float]]] = {}
    for design in KNOWN_DESIGNS:
        spans = found.setdefault(type(design), {})
        for name, (value, _) in numbers(design):
            if size := abs(value):
                least, most = spans.get(name, (size, size))
                spans[name] = min(least, size), max(most, size)
    return found


def doubt(name: str, value: float, unit: str, least: float, most: float, *, far: float = FAR) -> list[str]:
    """Return a line for a value that is far outside a range, else nothing.

    Args:
        name: of the value.
        value: SI, positive.
        unit: SI.
        least: smallest known value; 0 for none.
        most: largest known value.
        far: factor beyond which it is far; larger for inertias.
    """
    far = FAR_INERTIA if unit == "kg m2" else far
    if least / far <= value <= far * most:
        return []
    span = f"{shown(least, unit)} to {shown(most, unit)}" if least else f"up to {shown(most, unit)}"
    return [f"{name} = {shown(value, unit)}: known reducers have {span}; check the unit"]


def numbers(design: PyTree) -> Iterator[tuple[str, tuple[float, str]]]:
    """(path, (value of the largest size, SI unit)) of every quantity with a unit in a design."""
    for path, value, about in walk(design):
        if about["kind"] != "count" and about["unit"] not in ("-", "rad"):
            flat = np.ravel(np.asarray(value, float))
            yield path, (float(flat[np.argmax(np.abs(flat))]), about["unit"])


def walk(record: "DataclassInstance", prefix: str = "") -> Iterator[tuple[str, PyTree, Mapping[str, Any]]]:
    """(path, value, metadata of the field) of every given value of a design, such as "cycloid.pin_count".

    Args:
        record: a record of numbers and records.
        prefix: of the paths.
    """
    for f in dataclasses.fields(record):
        value = getattr(record, f.name)
        if f.metadata["kind"] == "record" and value is not None:
            yield from walk(value, f"{prefix}{f.name}.")
        elif value is not None:
            yield prefix + f.name, value, f.metadata


def shown(value: Scalar, unit: str) -> str:
    """A number with the largest unit in which it is at least one; a speed in revolutions per minute.

    Args:
        value: SI.
        unit: its SI unit.
    """
    name, size = ("r/min", rpm) if unit == "rad/s" else suited(float(value), unit)
    return with_unit(float(value) / size, name)
