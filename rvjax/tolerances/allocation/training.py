"""The fixed sample an allocation learns from: margins at the required yield, and their slopes.

The random numbers are drawn once and serve every set of tolerances, so that margins are smooth in
the half-widths. It certifies nothing: the optimum is fitted to these very units.
"""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy import special

from rvjax.status import succeeded
from rvjax.tolerances.population.layout import Layout, deviations, drawn, layout, root_key
from rvjax.tolerances.propagation.requirements import Requirement
from rvjax.tolerances.propagation.responses import BLOCK, Response, evaluate, respond

_BEYOND = 8  # units that must lie beyond a sampled quantile; further out the tail is extended as a normal one
# Slopes come from the units nearest the quantile: few enough to stand near it, where the response bends; cheap, too.
_FEWEST_LANES, _LANES_PART = 256, 32


@dataclasses.dataclass(frozen=True)
class Point:
    """What the sample says at one set of half-widths; constraints are the requirements, then the joint one.

    Attributes:
        half_widths: (j,) of the fields that have a cost.
        margins: (c,) margin of each constraint at its target yield: <= 0 is met, inf if too many units fail.
        slopes: (c, j) their derivatives to the logarithms of the half-widths.
        weights: (c, k) derivative of each constraint to the margin of each requirement.
    """

    half_widths: np.ndarray
    margins: np.ndarray
    slopes: np.ndarray
    weights: np.ndarray


class Training:
    """Margins of one sample of units as functions of the half-widths of the fields that have a cost."""

    def __init__(
        self,
        response: Response,
        parts: Layout,
        fields: tuple[str, ...],
        requirements: dict[str, Requirement],
        joint_target: float | None,
        samples: int,
        seed: int,
    ) -> None:
        self.response, self.parts, self.fields, self.requirements = response, parts, fields, requirements
        self.samples, self.joint = samples, joint_target is not None
        self.targets = [r.target for r in requirements.values()] + ([] if joint_target is None else [joint_target])
        self.lanes = min(samples, max(_FEWEST_LANES, samples // _LANES_PART))
        key, block = root_key(seed), min(samples, BLOCK)
        starts = range(0, samples, block)
        self.blocks = [drawn(parts.replace({}), key, jnp.uint32(start), count=block) for start in starts]
        # How far the nominal response stays from each limit; margins are measured from there.
        own, _ = self._own(np.zeros(len(fields)))
        nominal = -np.median(own, axis=1)
        self.scales = np.where(np.isfinite(nominal) & (nominal > 0), nominal, self._spread(own))
        self.distance = np.append(self.scales, 1.0) if self.joint else self.scales
        self.correction = np.ones(len(self.distance))

    @staticmethod
    def _spread(margins: np.ndarray) -> np.ndarray:
        """A positive size for margins whose nominal value already touches the limit."""
        finite = np.where(np.isfinite(margins), np.abs(margins), 0.0).max(axis=1)
        return np.where(finite > 0, finite, 1.0)

    def tolerances(self, half_widths: np.ndarray) -> Any:
        """The tolerances with these half-widths in the fields that have a cost."""
        active = self.parts.active
        return self.parts.replace({n: active[n].with_half_width(float(t)) for n, t in zip(self.fields, half_widths)})

    def margins(self, half_widths: np.ndarray) -> np.ndarray:
        """Margins of the constraints at their target yields (c,)."""
        return self._at_targets(self._with_joint(self._own(half_widths)[0]))

    def point(self, half_widths: np.ndarray) -> Point:
        """Margins and slopes."""
        own, signs = self._own(half_widths)
        margins = self._with_joint(own)
        at_target = self._at_targets(margins)
        chosen = [self._nearest(row, target) for row, target in zip(margins, self.targets)]
        cotangents = [self._cotangents(k, own, signs, lanes) for k, lanes in enumerate(chosen)]
        gradients = self._gradients(half_widths, np.concatenate(chosen), np.concatenate(cotangents))
        slopes = np.zeros((len(margins), len(self.fields)))
        for k, rows in enumerate(np.split(gradients, len(margins))):
            # Seen from the nominal response, slopes of a linear response grow like the margin itself;
            # least squares along that line brings the neighbouring units to the quantile.
            reach = margins[k, chosen[k]] + self.distance[k]
            used = np.isfinite(rows).all(axis=1) & np.isfinite(reach) & (reach > 0)
            if used.any() and np.isfinite(at_target[k]):
                fit = reach[used] @ rows[used] / (reach[used] ** 2).sum()
                slopes[k] = fit * (at_target[k] + self.distance[k]) * half_widths
        weights = np.stack([np.abs(rows).mean(axis=0) for rows in cotangents])
        return Point(half_widths, at_target, slopes, weights)

    def correct(self, point: Point, factors: np.ndarray) -> Point:
        """Learn from a larger sample that half-widths times `factors` would just meet each target.

        A few thousand units know a far quantile to a percent or two only. From now on the way of each
        active constraint from the nominal response is scaled by what the larger sample saw at `point`.
        """
        reach = np.maximum((point.margins + self.distance) / self.distance, 1e-3)
        seen = 1 / (factors * reach)
        active = (reach > 0.9) & (np.abs(np.log(seen)) < 0.2)
        ratio = np.where(active, seen, 1.0)
        self.correction = self.correction * ratio
        margins = ratio * (point.margins + self.distance) - self.distance
        return dataclasses.replace(point, margins=margins, slopes=ratio[:, None] * point.slopes)

    def _own(self, half_widths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Margin of each requirement and unit, inf where the unit failed; sign of its derivative to the response."""
        tolerances, rows, good = self.tolerances(half_widths), [], []
        for z in self.blocks:
            values, status = respond(self.response, tolerances, z)
            rows.append(np.stack([np.asarray(values[name], float) for name in self.requirements]))
            good.append(np.asarray(succeeded(status)))
        values, valid = np.concatenate(rows, axis=1)[:, : self.samples], np.concatenate(good)[: self.samples]
        margins, signs = np.full(values.shape, np.inf), np.zeros(values.shape)
        for k, requirement in enumerate(self.requirements.values()):
            margins[k, valid] = requirement.margin(values[k, valid])
            signs[k, valid] = requirement.outward(values[k, valid])
        return margins, signs

    def _with_joint(self, own: np.ndarray) -> np.ndarray:
        if not self.joint:
            return own
        return np.concatenate([own, (own / self.scales[:, None]).max(axis=0, keepdims=True)])

    def _cotangents(self, constraint: int, own: np.ndarray, signs: np.ndarray, lanes: np.ndarray) -> np.ndarray:
        """Derivative of a constraint's margin to the responses (lanes, k)."""
        found = np.zeros((len(lanes), len(own)))
        if constraint < len(own):
            found[:, constraint] = signs[constraint, lanes]
            return found
        leading = (own[:, lanes] / self.scales[:, None]).argmax(axis=0)
        found[np.arange(len(lanes)), leading] = (signs / self.scales[:, None])[leading, lanes]
        return found

    def _reachable(self, target: float) -> float:
        return min(target, 1 - _BEYOND / self.samples)

    def _at_targets(self, margins: np.ndarray) -> np.ndarray:
        """Quantile of each margin at its target, failed units above all others."""
        found = np.empty(len(margins))
        for k, (row, target) in enumerate(zip(margins, self.targets)):
            level = self._reachable(target)
            rank = (self.samples - 1) * level
            low = int(rank)
            ordered = np.partition(row, [low, min(low + 1, self.samples - 1)])
            a, b = ordered[low], ordered[min(low + 1, self.samples - 1)]
            quantile = a + (rank - low) * (b - a) if np.isfinite(b) else b
            further = special.ndtri((1 + target) / 2) / special.ndtri((1 + level) / 2)
            found[k] = (quantile + self.distance[k]) * further * self.correction[k] - self.distance[k]
        return found

    def _nearest(self, margins: np.ndarray, target: float) -> np.ndarray:
        """The units whose margins stand nearest the quantile, by rank among those that did not fail."""
        order = np.argsort(margins)
        valid = int(np.isfinite(margins).sum())
        start = round(self.samples * self._reachable(target)) - self.lanes // 2
        start = max(0, min(start, valid - self.lanes))
        return order[start : start + self.lanes]

    def _gradients(self, half_widths: np.ndarray, lanes: np.ndarray, cotangents: np.ndarray) -> np.ndarray:
        """Derivatives of the weighted responses of some units to the half-widths (lanes, j)."""
        z = np.concatenate([np.asarray(block) for block in self.blocks], axis=1)[:, lanes]
        arguments = (self.parts.replace({}), jnp.asarray(half_widths, z.dtype), z, jnp.asarray(cotangents.T, z.dtype))
        return np.asarray(_unit_gradients(self.response, tuple(self.requirements), self.fields, *arguments), float)


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def _unit_gradients(
    response: Response,
    names: tuple[str, ...],
    fields: tuple[str, ...],
    tolerances: Any,
    half_widths: jax.Array,
    z: jax.Array,
    cotangents: jax.Array,
) -> jax.Array:
    """Gradient of sum_k cotangent_k y_k to the half-widths, unit by unit: one reverse pass for all fields."""
    parts = layout(tolerances)

    def weighted(t: jax.Array, z: jax.Array, cotangent: jax.Array) -> jax.Array:
        widths = jnp.split(t, len(fields))  # the transpose of a split is one concatenation
        scaled = parts.replace({n: parts.active[n].with_half_width(w[0]) for n, w in zip(fields, widths)})
        errors = deviations(layout(scaled), z)
        values, _ = evaluate(response, parts.errors(errors))
        return jnp.stack([values[name] for name in names]) @ cotangent

    return jax.vmap(jax.grad(weighted), in_axes=(None, -1, -1))(half_widths, z, cotangents)
