"""Problem of an identification: model, prior, noise; and the compiled programs that evaluate it."""

import dataclasses
import math
import operator
from collections.abc import Callable, Iterable
from functools import cached_property, lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.identify.elements import Elements, values_of
from rvjax.identify.gauss_newton import Mode, half_square, mixed, mode
from rvjax.identify.noise import Noise
from rvjax.identify.observation import Layout, flatten
from rvjax.population import Correlation, Population
from rvjax.records import PyTree
from rvjax.response import PROGRAMS, per_response

Model = Callable[[PyTree], PyTree]

LANES = 64
"""Points that are evaluated at once where only the density is required."""


class Given(NamedTuple):
    """Prior and noise of a problem, traced."""

    population: Population
    mixing: jax.Array  # M (p, n)
    sd: jax.Array  # (m,)
    dof: jax.Array | None  # of Student noise; None is normal noise


@dataclasses.dataclass(frozen=True, eq=False)
class Problem:
    """A model with its prior and noise, checked.

    Attributes:
        model: values of the prior's structure -> observation.
        elements: of the prior.
        layout: of the observation.
        sd: noise of each real number (m,), unit of the observation.
        dof: of Student noise; inf is normal.
        nuisance: places of elements that are not of interest.
    """

    model: Model
    elements: Elements
    layout: Layout
    sd: np.ndarray
    dof: float
    nuisance: np.ndarray

    @classmethod
    def of(
        cls,
        model: Model,
        prior: PyTree,
        *,
        noise: Noise,
        nuisance: str | Iterable[str] = (),
        correlation: Correlation = None,
    ) -> "Problem":
        """Return the problem of what users give.

        Raises:
            ValueError: as the parts of it.
        """
        if not isinstance(noise, Noise):
            raise ValueError(f"noise = {noise!r}: must be a Noise(sd), unit of the observation")
        elements = Elements.of(prior, correlation)
        layout = _layout(model, elements)
        places = elements.places("nuisance", nuisance)
        return cls(model, elements, layout, layout.sd(noise.sd), float(noise.dof), places)

    @property
    def discount(self) -> float:
        """Expected information of Student noise over the information of normal noise, (dof + 1)/(dof + 3)."""
        return 1.0 if math.isinf(self.dof) else (self.dof + 1) / (self.dof + 3)

    @cached_property
    def device(self) -> "Given":
        """Prior and noise as the programs take them."""
        dof = None if math.isinf(self.dof) else jnp.asarray(self.dof)
        return Given(self.elements.population, jnp.asarray(self.elements.mixing), jnp.asarray(self.sd), dof)


@lru_cache(PROGRAMS)
def _layouts(model: Model) -> dict[object, Layout]:
    """Layouts of a model's observation by structure of its prior; a model is traced once for each."""
    return {}


def _layout(model: Model, elements: Elements) -> Layout:
    u = jax.ShapeDtypeStruct((elements.count,), jnp.result_type(float))
    known, key = _layouts(model), (jax.tree.structure(elements.population), u.dtype)
    if key not in known:
        stated: Callable[[np.dtype], PyTree] | None = getattr(model, "shapes", None)
        if stated is None:
            seen = jax.eval_shape(lambda p, u: model(values_of(p, u)), elements.population, u)
        else:  # such a model need not be traced
            seen = stated(u.dtype)
        known[key] = Layout.of(seen)
    return known[key]


def residuals(model: Model, given: Given, y: jax.Array, u: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
    """Whitened residuals (f - y)/sd (m,), 0 where y is NaN; the observation f, and the norm of what is subtracted."""
    seen, observation = ~jnp.isnan(y), flatten(model(values_of(given.population, u))).astype(y.dtype)
    found, y = (jnp.where(seen, item, 0) / given.sd for item in (observation, y))
    return found - y, (observation, jnp.linalg.norm(jnp.abs(found) + jnp.abs(y)))


Residual = Callable[[jax.Array], tuple[jax.Array, PyTree]]  # value, and what else it gives


def slopes(function: Residual, u: jax.Array, size: int) -> tuple[jax.Array, jax.Array, PyTree]:
    """Value (m,), Jacobian (m, p) and what else a function gives, by the cheaper of forward and reverse mode.

    A tangent costs about half of a cotangent. If a model supports only one of the two, that one is used.
    """
    ways = [_forward, _reverse] if u.shape[0] <= 2 * size else [_reverse, _forward]
    try:
        return ways[0](function, u)
    except (TypeError, ValueError, NotImplementedError):
        return ways[1](function, u)


def _forward(function: Residual, u: jax.Array) -> tuple[jax.Array, jax.Array, PyTree]:
    push: Callable[[jax.Array], Any] = lambda tangent: jax.jvp(function, (u,), (tangent,), has_aux=True)  # noqa: E731
    value, jacobian, aux = jax.vmap(push, out_axes=(None, -1, None))(jnp.eye(u.shape[0], dtype=u.dtype))
    return value, jacobian, aux


def _reverse(function: Residual, u: jax.Array) -> tuple[jax.Array, jax.Array, PyTree]:
    value, pull, aux = jax.vjp(function, u, has_aux=True)
    return value, jax.vmap(lambda cotangent: pull(cotangent)[0])(jnp.eye(value.shape[0], dtype=value.dtype)), aux


def linearised(
    model: Model, given: Given, y: jax.Array, u: jax.Array
) -> tuple[jax.Array, jax.Array, tuple[jax.Array, jax.Array]]:
    """Residuals (m,), slopes over u (m, p), the observation (m,) and the size of the numbers behind the residuals."""
    return slopes(lambda u: residuals(model, given, y, u), u, y.shape[0])


@per_response()
def linearise(model: Model, given: Given, u: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the whitened observation (m,) and its slopes over u (m, p) at one u."""
    observation, jacobian, _ = linearised(model, given, jnp.zeros_like(given.sd), u)
    return observation, jacobian


@per_response()
def modes(model: Model, given: Given, y: jax.Array, starts: jax.Array, max_steps: jax.Array) -> Mode:
    """Return the modes of units y (k, m) from starts (k, n)."""

    def one(y: jax.Array, start: jax.Array) -> Mode:
        linearise = partial(linearised, model, given, y)
        return mode(linearise, y.shape[0], given.mixing, start, given.dof, max_steps)

    return jax.vmap(one)(y, starts)


@per_response()
def densities(model: Model, given: Given, y: jax.Array, z: jax.Array) -> jax.Array:
    """Phi (k,) at points z (k, n) for one unit y (m,); inf where the model is not finite."""

    def phi(z: jax.Array) -> jax.Array:
        residual, _ = residuals(model, given, y, mixed(given.mixing, z))
        value = jnp.sum(z**2) / 2 + half_square(residual, given.dof)
        return jnp.where(jnp.isfinite(value), value, jnp.inf)

    return jax.lax.map(phi, z, batch_size=LANES)


def counted(name: str, value: int, least: int) -> None:
    """Raise ValueError for a value that is no count."""
    if integer(name, value) < least:
        raise ValueError(f"{name} = {value!r}: must be at least {least}, unit -")


def integer(name: str, value: int) -> int:
    """Return an integer; a ValueError names a value that is not one."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise ValueError(f"{name} = {value!r}: must be an integer, unit -") from None
