"""Angles of its span at which a unit is solved: those where its extremes are expected.

A curve of the reducer at an angle is nearly linear in the errors of its parts, so that mean slopes predict the curve of
any unit. Its extremes at the chosen angles are a little smaller than those at all; a factor for each curve, the mean of
other units, makes up for that. Gain: with 10 of 481 angles of a turn of the output of an RV-40E the limits that 98.6 %
of the units keep are 2 to 3 % too high, with 97 equal ones, which take five times as long, 1 to 3 % too low
(`benchmarks/chosen_angles.py`).

A unit keeps its angles while tolerances change: its errors count as if they had the tolerances of the curves. Otherwise
its values jump where an angle is exchanged for another, and a search solves twice as many units.
"""

import functools
import itertools
import math
from collections.abc import Collection
from typing import Self

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import models
from rvjax._jax.kernels import in_blocks
from rvjax._jax.programs import QUICK
from rvjax.population import Population, drawn, root_key
from rvjax.records import Array, PyTree, Record, field, record, text
from rvjax.response import elements, per_response
from rvjax.study.response import Response

UNITS, AT_ONCE = 32, 8
"""Units whose slopes are averaged, and at once. Of the variance of the error of a drive 16 units predict 87 %, 64 units
89 %."""
OPTIONS = (*QUICK, ("xla_backend_optimization_level", 1))
"""Of the program of the slopes: level 1 takes 1.1 s for 32 units of `rv-40e-whole` at 481 angles, level 0 3.6 s."""
SEED = 481
"""Of these units; no sample or certificate of an embedded study has it."""

Places = tuple[tuple[int, int, int], ...]


@record
class Expected(Record):
    """Curves along a span, linear in the errors of a unit, and what is read off them."""

    angles: Array = field("rad", "of the input", shape=("n",))
    middle: Array = field("as the curves", "of a unit without errors", shape=("curves", "n"))
    slopes: Array = field("as the curves", "to the elements of the errors", shape=("curves", "n", "elements"))
    factors: Array = field("-", "extremes over those at the chosen angles, mean of units", shape=("curves",))
    limits: Array = field("as the errors", "centres and half-widths that the units had", shape=(2, "elements"))
    own: Array = field("as the errors", "those of the population of a unit", shape=(2, "elements"))
    fields: tuple[tuple[str, tuple[int, ...]], ...] = text("errors of the elements in turn, with shapes")
    places: Places = text("curve, 1 for highest or -1 for lowest, their number")

    def among(self, population: Population) -> Self:
        """The same for units of other tolerances.

        Args:
            population: of the units.
        """
        return self.replace(own=_limits(self.fields, population, self.limits))

    @property
    def central(self) -> Self:
        """The same for a unit at the centre of its tolerances or without errors, whose curves are the expected ones."""
        return self.replace(factors=jnp.ones_like(self.factors))

    @staticmethod
    def near(response: Response, population: Population) -> "Expected":
        """Curves of units of another population, by `learned`."""
        return learned(response, population)

    def angles_of(self, errors: PyTree) -> jax.Array:
        """Input angles (m,) at which a unit is solved, rad: in each part of the span those of the expected extremes.

        Args:
            errors: of the unit.
        """
        each = (jnp.broadcast_to(getattr(errors, name), shape) for name, shape in self.fields)
        vector = jax.lax.stop_gradient(jnp.concatenate([jnp.ravel(error) for error in each]))
        (centre, width), (own_centre, own_width) = self.limits, jax.lax.stop_gradient(self.own)
        scaled = (width > 0) & (own_width > 0)
        ratio = jnp.where(scaled, width / jnp.where(scaled, own_width, 1), 1)
        curves = self.middle + self.slopes @ (centre + ratio * (vector - own_centre))
        return jnp.asarray(self.angles)[_chosen(curves, self.places)]


def _limits(fields: tuple[tuple[str, tuple[int, ...]], ...], population: Population, other: Array) -> jax.Array:
    """Centres and half-widths (2, elements) of a population, `other` ones of errors without a tolerance."""
    found, start = [], 0
    for name, shape in fields:
        end = start + math.prod(shape)
        one = population.active.get(name)
        both = other[:, start:end] if one is None else jnp.stack([jnp.asarray(one.centre), jnp.asarray(one.half_width)])
        found.append(jnp.broadcast_to(jnp.reshape(both, (2, -1)), (2, end - start)))
        start = end
    return jnp.concatenate(found, axis=1)


def _chosen(curves: jax.Array, places: Places) -> jax.Array:
    """Numbers of the chosen places of curves (curves, n)."""
    return jnp.concatenate([_highest(sign * curves[k], parts) for k, sign, parts in places])


def _highest(curve: jax.Array, parts: int) -> jax.Array:
    """Number of the highest place in each part of a curve (n,)."""
    ends = np.round(np.linspace(0, len(curve), parts + 1)).astype(int)
    return jnp.stack([low + jnp.argmax(curve[low:high]) for low, high in itertools.pairwise(ends)])


def takes_few(response: Response, tolerances: PyTree) -> bool:
    """True where the conditions let units choose their angles, and the outputs need no others.

    Args:
        response: of a study.
        tolerances: of its units.
    """
    few = models.kind(response.design).extremes(response.outputs)
    if few is None or few.solved(response.conditions) is None or not Population.of(tolerances).active:
        return False
    reading = {name for name in response.outputs if (None, few.source) in response.read(name)}
    return bool(reading) and reading <= set(few.outputs)


def learned(response: Response, population: Population) -> Expected:
    """Expected curves of the units of a study, and the angles that they choose.

    Args:
        response: that `takes_few`.
        population: of the units whose slopes are averaged; those that fail are left out.
    """
    few = models.kind(response.design).extremes(response.outputs)
    assert few is not None
    z = np.asarray(drawn(population, root_key(SEED), np.uint32(0), count=UNITS))
    errors = np.asarray(elements(population, jnp.asarray(z)))
    # On one device: shared out, the last bits would follow the number of devices.
    values, slopes = in_blocks(lambda some: _slopes(response, population, some.T), AT_ONCE, errors.T)
    at_zero = values - np.einsum("unce,eu->unc", slopes, errors)  # (units, n, c)
    good = np.isfinite(at_zero)  # not where a slope is NaN either
    share = good / np.maximum(good.sum(axis=0), 1)
    middle = np.einsum("unc,unc->cn", share, np.where(good, at_zero, 0))
    slopes = np.einsum("unc,unce->cne", share, np.where(good[..., None], slopes, 0))
    middle.setflags(write=False)
    slopes.setflags(write=False)  # they stay on the devices between calls
    read = {k for name in response.outputs if (k := few.outputs.get(name)) is not None}
    places = _places(few.solved(response.conditions) or 0, at_zero.shape[2], read)
    fields = tuple((name, tolerance.shape) for name, tolerance in population.active.items())
    limits = jnp.asarray(_limits(fields, population, jnp.zeros((2, 0))))
    fine = good.all(axis=(1, 2))
    seen, told = np.moveaxis(values, 1, 2)[fine], (middle + np.einsum("cne,eu->ucn", slopes, errors))[fine]
    factors = jnp.asarray(_factors(seen, told, places))
    return Expected(
        angles=few.angles(response.design, response.conditions),
        middle=middle,
        slopes=slopes,
        factors=factors,
        limits=limits,
        own=limits,
        fields=fields,
        places=places,
    )


def _factors(seen: np.ndarray, expected: np.ndarray, places: Places) -> np.ndarray:
    """Extremes of curves (units, curves, n) over those at the angles that the mean slopes of the other units choose."""
    units, curves, _ = seen.shape
    if units < 2:
        return np.ones(curves)
    by_others = (units * expected - seen) / (units - 1)
    chosen = np.asarray(jax.jit(jax.vmap(functools.partial(_chosen, places=places)))(by_others))
    some, factors = np.take_along_axis(seen, chosen[:, None], axis=2), np.ones(curves)
    for k in range(curves):
        signs = (1, -1) if k == 0 else (1,)
        whole, few = (sum((sign * of[:, k]).max(axis=1) for sign in signs).sum() for of in (seen, some))
        factors[k] = whole / few if few > 0 else 1.0
    return factors


def _places(solved: int, curves: int, read: Collection[int]) -> Places:
    """Curve, 1 for its highest or -1 for its lowest places, and their number.

    Curves that no output reads have none. Where one reads the first, one place of six is for all others.

    Args:
        solved: places.
        curves: their number.
        read: curves of the outputs; empty: all.
    """
    wanted = [k for k in range(curves) if not read or k in read]
    others = [k for k in wanted if k]
    first = 0 if wanted == others else (solved - bool(others) * max(len(others), solved // 6)) // 2
    rest = solved - 2 * first
    shares = {k: rest // len(others) + (i < rest % len(others)) for i, k in enumerate(others)}
    return (*((0, sign, first) for sign in (1, -1) if first), *((k, 1, share) for k, share in shares.items()))


@per_response(options=OPTIONS)
def _slopes(response: Response, population: Population, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Curves (units, n, c) at all angles of the span and their slopes to the errors (elements, units)."""
    few = models.kind(response.design).extremes(response.outputs)
    assert few is not None
    angles = jnp.asarray(few.angles(response.design, response.conditions), errors.dtype)
    units, n = errors.shape[1], len(angles)

    def one(vector: jax.Array, angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        def curves(vector: jax.Array) -> jax.Array:
            own = response.bounded(population.fill(population.by_field(vector)))
            return few.curves(response.design, own, response.conditions, angle)

        values, pull = jax.vjp(curves, vector)
        return values, jax.vmap(lambda cotangent: pull(cotangent)[0])(jnp.eye(len(values), dtype=values.dtype))

    # Under one `jax.vmap`, so that no loop over the angles surrounds that of Newton's method.
    found = jax.vmap(one)(jnp.repeat(errors.T, n, axis=0), jnp.tile(angles, units))
    return jax.tree.map(lambda rows: rows.reshape(units, n, *rows.shape[1:]), found)
