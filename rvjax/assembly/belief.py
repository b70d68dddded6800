"""Beliefs on measured parts: their posterior from value, spread of the gauge and population, and draws of it.

Without the population a plan chases the noise of the gauge: the best of many noisy values is mostly noise.
"""

import dataclasses
import zlib
from collections.abc import Hashable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax._jax.checks import checked, numbers
from rvjax.assembly.parts import Kind, Part, at_path
from rvjax.records import PyTree, Scalar
from rvjax.tolerances import Tolerance

NODES = 129
_REACH = 8.2  # standard normal: what lies beyond has a share of 2e-16
_DEPTH = 40.0  # in the logarithm: less likely nodes weigh nothing in double precision
_ENOUGH = 40  # nodes in the window; the trapezoidal rule then has every digit of a bell
_ROUNDS = 60


@dataclasses.dataclass(frozen=True)
class Belief:
    """Posterior of the elements of one error of many parts.

    Attributes:
        mean: (parts, *shape).
        sd: (parts, *shape).
        value: nodes of the posterior (NODES, elements), None where it is normal.
        below: share of the posterior below each node (NODES, elements).
    """

    mean: np.ndarray
    sd: np.ndarray
    value: np.ndarray | None = None
    below: np.ndarray | None = None

    @property
    def certain(self) -> bool:
        """True if no error is random."""
        return not self.sd.any()

    def drawn(self, z: np.ndarray) -> np.ndarray:
        """Errors of parts (parts, draws, *shape).

        Args:
            z: standard normal (parts or 1, draws, *shape).
        """
        if self.value is None or self.below is None:
            return self.mean[:, None] + self.sd[:, None] * z
        draws = z.shape[1]
        share = special.ndtr(np.broadcast_to(z, (len(self.mean), *z.shape[1:])))
        by_element = np.moveaxis(share, 1, 0).reshape(draws, -1)
        columns = [np.interp(by_element[:, k], self.below[:, k], self.value[:, k]) for k in range(by_element.shape[1])]
        return np.moveaxis(np.stack(columns, axis=1).reshape(draws, *self.mean.shape), 0, 1)


@checked
def believed(value: object, sd: object, tolerance: Tolerance | None) -> tuple[Scalar, Scalar]:
    """Mean and standard deviation of an error that was measured.

    Of a normal population N(mu, s0^2) measured with s: g = s0^2/(s0^2 + s^2), mean mu + g (value - mu), sd
    s0 sqrt(1 - g). Else: the posterior on 129 nodes. A von Mises vector has the mean and spread of its
    components.

    Args:
        value: measured, unit of the error, any shape.
        sd: standard deviation of the measurement, of that shape or one number; inf: not measured.
        tolerance: the population; None: only the measurement is known.

    Raises:
        ValueError: a value that is not finite, or a negative standard deviation.
    """
    values, sds = numbers("value", value), numbers("sd", sd)
    if sds.shape not in ((), values.shape):
        raise ValueError(f"sd: shape {sds.shape}: must be one number or of the shape of value, {values.shape}")
    if not np.isfinite(values).all():
        raise ValueError(f"value = {value!r}: must be finite")
    if not (sds >= 0).all():
        raise ValueError(f"sd = {sd!r}: must be zero or positive")
    posterior = belief(values[None], np.broadcast_to(sds, values.shape)[None], tolerance)
    mean, spread = posterior.mean[0], posterior.sd[0]
    return (mean, spread) if values.ndim else (float(mean), float(spread))


def belief(value: np.ndarray, sd: np.ndarray, tolerance: Tolerance | None) -> Belief:
    """Posterior of one error of many parts.

    Args:
        value: measured (parts, *shape).
        sd: of the measurement (parts, *shape).
        tolerance: the population, or None.
    """
    if tolerance is None or not sd.any():
        return Belief(value, sd)
    own = tolerance.replace(shape=value.shape[1:])
    mean, variance = (np.broadcast_to(np.asarray(moment, float), value.shape) for moment in own.moments()[:2])
    if own.law.is_normal(own) or own.law.couples:
        with np.errstate(divide="ignore", invalid="ignore"):
            gain = np.where(sd == 0, 1.0, np.where(np.isinf(sd), 0.0, variance / (variance + sd**2)))
        shrunk = np.where(sd == 0, value, mean + gain * (value - mean))
        return Belief(shrunk, np.where(sd == 0, 0.0, np.sqrt(variance * (1 - gain))))
    return _on_nodes(own.replace(shape=()), value, sd)


@jax.jit
def deviates(tolerance: Tolerance, z: jax.Array) -> jax.Array:
    """Errors of a tolerance at standard normal numbers.

    Args:
        tolerance: distribution of the error.
        z: any shape.
    """
    return tolerance.deviate(z)


def _on_nodes(tolerance: Tolerance, value: np.ndarray, sd: np.ndarray) -> Belief:
    """Nodes in z around the bulk of the posterior; all elements at once."""
    y, s = value.reshape(-1), np.maximum(sd.reshape(-1), 1e-9 * max(float(tolerance.half_width), 1e-300))
    low, high = np.full(y.size, -_REACH), np.full(y.size, _REACH)
    steps = np.linspace(0.0, 1.0, NODES)[:, None]
    for _ in range(_ROUNDS):
        z = low + (high - low) * steps
        nodes = np.asarray(deviates(tolerance, jnp.asarray(z)), float)
        depth = -(z**2) / 2 - ((y - nodes) / s) ** 2 / 2
        depth -= depth.max(axis=0)
        kept = depth > -_DEPTH
        first, last = kept.argmax(axis=0), NODES - 1 - kept[::-1].argmax(axis=0)
        if (last - first >= _ENOUGH).all():
            break
        wide = np.take_along_axis(z, np.stack([np.maximum(first - 1, 0), np.minimum(last + 1, NODES - 1)]), axis=0)
        few = last - first < _ENOUGH
        low, high = np.where(few, wide[0], low), np.where(few, wide[1], high)
    weight = np.exp(depth)
    weight /= weight.sum(axis=0)
    mean = (weight * nodes).sum(axis=0)
    spread = np.sqrt((weight * (nodes - mean) ** 2).sum(axis=0))
    exact = sd.reshape(-1) == 0
    mean, spread = np.where(exact, y, mean), np.where(exact, 0.0, spread)
    nodes = np.where(exact, y, nodes)
    below = np.cumsum(weight, axis=0) - weight / 2
    return Belief(mean.reshape(value.shape), spread.reshape(value.shape), nodes, below)


def _left_out(value: object, part: Part) -> bool:
    """Return whether a field of a record is not measured: the default 0.0, without a standard deviation."""
    return isinstance(value, float) and value == 0.0 and isinstance(part.sd, (int, float))


@dataclasses.dataclass(frozen=True, eq=False)
class Known:
    """All parts of a kind, in an order that depends on the errors only.

    A plan does not depend on names and order of the parts.

    Attributes:
        kind: as given.
        order: place in `kind.parts` of each part (parts,).
        pieces: of each part (parts,).
        beliefs: of each leaf of the errors that is no constant zero.
        still: places of the leaves that are a constant zero.
        structure: of the errors of one part.
    """

    kind: Kind
    order: np.ndarray
    pieces: np.ndarray
    beliefs: tuple[Belief, ...]
    still: frozenset[int]
    structure: PyTree

    @property
    def certain(self) -> bool:
        """True if no error is random."""
        return all(one.certain for one in self.beliefs)

    def id_of(self, place: int) -> Hashable:
        """Label of a part."""
        return self.kind.parts[int(self.order[place])].id

    def drawn(self, rng: np.random.Generator, draws: int, *, alike: bool) -> list[np.ndarray]:
        """Errors by leaf (parts, draws, *shape).

        Args:
            rng: random numbers.
            draws: their count; 1 with nothing to draw.
            alike: antithetic draws that are common to all parts; else each part has its own.
        """
        leaves = []
        for one in self.beliefs:
            shape = one.mean.shape[1:]
            if one.certain:
                leaves.append(np.broadcast_to(one.mean[:, None], (len(one.mean), draws, *shape)))
                continue
            if alike:
                half = rng.standard_normal((1, draws // 2, *shape))
                z = np.concatenate([half, -half, np.zeros((1, draws % 2, *shape))], axis=1)
            else:
                z = rng.standard_normal((len(one.mean), draws, *shape))
            leaves.append(one.drawn(z))
        return leaves


def known(kind: Kind, slot: str) -> Known:
    """Measured parts of one kind.

    Raises:
        ValueError: parts whose errors differ in structure or shape.
    """
    columns, structure = [], None
    for part in kind.parts:
        leaves, own = jax.tree_util.tree_flatten_with_path(part.errors)
        if structure is not None and own != structure:
            raise ValueError(f"{slot}: the errors of part {part.id!r} must have the structure of the parts before it")
        structure = own
        columns.append(leaves)
    population = getattr(kind.population, "tolerances", kind.population)
    values, spreads, tolerances, still = [], [], [], set()
    for place, (path, _) in enumerate(columns[0]):
        name = jax.tree_util.keystr(path, simple=True, separator=".")
        given = [column[place][1] for column in columns]
        tolerance = at_path(population, path, None)
        if tolerance is not None and not isinstance(tolerance, Tolerance):
            raise ValueError(f"{slot}: population of {name} = {tolerance!r}: must be a Tolerance or None")
        of_record = bool(path) and isinstance(path[-1], jax.tree_util.GetAttrKey)
        if of_record and tolerance is None and all(map(_left_out, given, kind.parts)):
            still.add(place)
            continue
        try:
            stacked = np.stack(np.broadcast_arrays(*map(np.asarray, given)))
            spread = [
                np.broadcast_to(np.asarray(at_path(p.sd, path, 0.0), float), stacked.shape[1:]) for p in kind.parts
            ]
        except ValueError:
            raise ValueError(f"{slot}: {name} must have one shape in all parts") from None
        if tolerance is None and np.isinf(spread).any():
            raise ValueError(f"{slot}: {name} is not measured (sd = inf); give its population")
        values.append(stacked if np.iscomplexobj(stacked) else stacked.astype(float))
        spreads.append(np.stack(spread))
        tolerances.append(tolerance)
    keys = [
        np.concatenate([np.empty(0), *(np.ravel(x[k]) for x in (*values, *spreads))]) for k in range(len(kind.parts))
    ]
    pieces = kind.pieces
    order = np.array(sorted(range(len(kind.parts)), key=lambda k: (tuple(keys[k].view(float)), pieces[k])))
    beliefs = tuple(belief(v[order], s[order], t) for v, s, t in zip(values, spreads, tolerances))
    return Known(kind, order, pieces[order], beliefs, frozenset(still), structure)


def draw(
    slots: Mapping[str, Known], seed: int, purpose: int, draws: int, *, alike: bool
) -> dict[str, list[np.ndarray]]:
    """Errors of all parts by slot; the draws of a slot depend on its name, not on its place.

    Args:
        slots: what is known of the parts.
        seed: of the study.
        purpose: 0 to choose, 1 to value; draws for one never serve the other.
        draws: their count.
        alike: common to all parts of a slot.
    """
    errors: dict[str, list[np.ndarray]] = {}
    by_stock: dict[int, str] = {}
    for slot, one in slots.items():
        if not alike and id(one) in by_stock:
            errors[slot] = errors[by_stock[id(one)]]  # the same piece in any slot
            continue
        by_stock.setdefault(id(one), slot)
        rng = np.random.default_rng([seed % 2**64, purpose, zlib.crc32(slot.encode())])
        errors[slot] = one.drawn(rng, draws, alike=alike)
    return errors
