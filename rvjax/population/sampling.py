"""Tolerances of a design, and the errors of one unit.

Scrambled Sobol points as the random numbers of units, computed on the host.

Unit i is point i // 16 of scramble i mod 16: every 16 neighbours are one point of each of 16 independent
scrambles (Owen 1995), whose spread gives standard errors.
"""

import dataclasses
import functools
import math
import operator
from typing import TYPE_CHECKING

import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.checks import checked
from rvjax.base.fields import axis_sizes
from rvjax.base.words import choose, unknown
from rvjax.population.population import TURN, Correlation, Population, key_of, root_key
from rvjax.population.tolerance import Tolerance
from rvjax.records import Design, PyTree, Scalar, is_concrete

if TYPE_CHECKING:
    from scipy.stats import qmc

SCRAMBLES = 16
_BITS = 32  # SciPy cannot fast-forward more of them


@functools.lru_cache(maxsize=8)
def first_points(numbers: int, seed: int, count: int) -> np.ndarray:
    """`SobolPoints.z` of the first units, which every sample of a search begins with; not to be written to."""
    z = SobolPoints(numbers, seed).z(0, count)
    z.flags.writeable = False
    return z


class SobolPoints:
    """The z of any range of units of one study."""

    def __init__(self, numbers: int, seed: int) -> None:
        """With this many random numbers per unit."""
        self._numbers, self._seed = numbers, operator.index(seed) % 2**64
        self._engines: dict[int, qmc.Sobol] = {}

    def z(self, start: int, count: int) -> np.ndarray:
        """Standard normal numbers of units start .. start + count - 1, (numbers, count)."""
        z = np.empty((self._numbers, count))
        if not self._numbers:
            return z
        for scramble in range(SCRAMBLES):
            offset = (scramble - start) % SCRAMBLES
            points = math.ceil((count - offset) / SCRAMBLES)
            if points > 0:
                z[:, offset::SCRAMBLES] = self._points(scramble, (start + offset) // SCRAMBLES, points).T
        # A point represents a cell of width 2^-32: its mid-point, which is never 0 or 1.
        return special.ndtri(z + 0.5 / 2**_BITS)

    def _points(self, scramble: int, first: int, points: int) -> np.ndarray:
        from scipy.stats import qmc  # a second: half of the start of a command that draws none

        engine = self._engines.get(scramble)
        if engine is None or engine.num_generated > first:
            rng = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(scramble,)))
            engine = self._engines[scramble] = qmc.Sobol(self._numbers, scramble=True, bits=_BITS, rng=rng)
        if first > engine.num_generated:
            engine.fast_forward(first - engine.num_generated)
        if engine.num_generated:
            return engine.random(points)
        # The very first point by itself: SciPy would warn about a first draw that is no power of two.
        return np.concatenate([engine.random(1), engine.random(points - 1)])


def for_design(design: Design, **tolerances: Tolerance | None) -> PyTree:
    """Tolerances of a design: its error record with a `Tolerance` or None in each field, shapes filled in.

    Args:
        design: names its error record and the sizes of its axes (`error_record`, `counts`).
        **tolerances: a `Tolerance` or None per field of that record; absent fields are exactly nominal.

    Raises:
        ValueError: unknown field, not a tolerance, or a shape or a distribution that does not fit the design.
    """
    cls, filled = design.error_record, {}
    declared = {f.name: f.metadata["shape"] for f in dataclasses.fields(cls)}
    signs = {f.name: f.metadata["sign"] for f in dataclasses.fields(cls)}
    for name in tolerances:
        if name not in declared:
            raise unknown(f"{cls.__name__} has no field {name!r}", name, sorted(declared), "; it has")
    for name, axes in declared.items():
        tolerance = tolerances.get(name)
        if tolerance is not None:
            if not isinstance(tolerance, Tolerance):
                raise ValueError(f"{name} = {tolerance!r}: must be a Tolerance or None")
            sizes = axis_sizes(axes, design.counts, tolerance.shape)
            if axes and not sizes:
                raise ValueError(f"{name}: Tolerance.shape = {tolerance.shape}: a series needs its length, {axes}")
            if tolerance.shape not in ((), sizes):
                raise ValueError(
                    f"{name}: Tolerance.shape = {tolerance.shape} does not fit this design, expected {sizes}"
                )
            # An axis of two cranks is no vector; only a literal 2 in the record is [radial, tangential].
            vector = bool(axes) and axes[-1] == 2
            tolerance = tolerance.replace(shape=sizes, vector=vector, clearance=signs[name] == "nonnegative")
            tolerance.law.check_field(name, tolerance)
        filled[name] = tolerance
    return cls(**filled)


METHODS = ("random", "sobol")


def check_method(method: str) -> None:
    """Raise a ValueError for an unknown way to draw units."""
    choose("method", method, METHODS)


@checked
def sample(
    tolerances: PyTree, index: Scalar, *, seed: int, method: str = "random", correlation: Correlation = None
) -> PyTree:
    """Return the errors of unit number `index`; vmaps over `index` for random units.

    The unit depends on seed, index and method, on which fields are active (each draws its own
    numbers); not on the limits, which only scale the numbers, nor on chunks or devices.

    Args:
        tolerances: record or dict with a `Tolerance` or None in each field.
        index: number of the unit, 0 or more; below 2^32 where it is traced.
        seed: of the study.
        method: "random", or "sobol": sampled on the host, so that `index` must be a number.
        correlation: {(field or element, field or element): correlation of their z}, such as
            {("pin_radius", "disc_bore[0,1,0]"): 0.5}.

    Returns:
        The structure of `tolerances` with errors in place of tolerances; inactive fields are 0.0.
    """
    check_method(method)
    if is_concrete(index) and not (index >= 0 and float(index).is_integer()):
        raise ValueError(f"index = {index!r}: must be an integer of at least 0")
    population = Population.of(tolerances, correlation)
    if method == "random":
        turn, index = divmod(int(index), TURN) if is_concrete(index) else (0, index)
        z = population.draw(key_of(root_key(seed), turn), jnp.asarray(index, jnp.uint32)[None])[:, 0]
    elif is_concrete(index):
        z = jnp.asarray(SobolPoints(population.numbers, seed).z(int(index), 1)[:, 0], jnp.result_type(float))
    else:
        raise ValueError("index: must be a number for method 'sobol', whose points are computed on the host")
    return population.errors(z)
