"""Model, prior and noise of an identification, and the compiled programs that evaluate them."""

import dataclasses
import math
import operator
from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import in_blocks
from rvjax._jax.sizes import DENSITIES, LINEARISED
from rvjax.identify.elements import Elements, elementwise, values_of
from rvjax.identify.gauss_newton import Linearised, half_square, mixed
from rvjax.identify.observation import Layout, Noise, flatten
from rvjax.population import Correlation, Population
from rvjax.records import PyTree
from rvjax.response import PROGRAMS, per_response

Model = Callable[[PyTree], PyTree]


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
        dof: of Student noise; None is normal noise.
        nuisance: places of elements that are not of interest.
    """

    model: Model
    elements: Elements
    layout: Layout
    sd: np.ndarray
    dof: float | None
    nuisance: np.ndarray

    @classmethod
    def of(
        cls,
        model: Model,
        prior: object,
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
        dof = None if math.isinf(noise.dof) else float(noise.dof)
        return cls(model, elements, layout, layout.sd(noise.sd), dof, places)

    @property
    def discount(self) -> float:
        """Expected information of Student noise over the information of normal noise, (dof + 1)/(dof + 3)."""
        return 1.0 if self.dof is None else (self.dof + 1) / (self.dof + 3)

    @cached_property
    def device(self) -> "Given":
        """Prior and noise as the programs take them."""
        dof = None if self.dof is None else jnp.asarray(self.dof)
        return Given(self.elements.population, jnp.asarray(self.elements.mixing), jnp.asarray(self.sd), dof)

    def evaluate(
        self,
        x: np.ndarray,
        *,
        models: Sequence[Model] = (),
        plain: bool = False,
        part: bool = False,
        together: int = LINEARISED,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Observations (k, m) and their slopes over x (k, m, p) of several units, block by block.

        Args:
            x: standard numbers (k, p).
            models: of each unit, that differ in fields of their parts alone; by default all have that of the problem.
            plain: x are values themselves.
            part: the first part of the model in place of all of it.
            together: units or parts in a block.
        """
        split = [parts_of(model) for model in models or [self.model]]
        every = [fields[:1] if part else fields for _, fields in split] * (1 if models else len(x))
        rows = np.repeat(np.arange(len(x)), [len(fields) for fields in every])
        flat = [each for fields in every for each in fields]
        names = list(flat[0])
        columns = [np.stack([np.asarray(each[name]) for each in flat]) for name in names]

        def block(x: np.ndarray, plain: np.ndarray, *columns: np.ndarray) -> tuple[jax.Array, jax.Array]:
            fields = dict(zip(names, columns))
            return linearise(split[0][0], self.elements.population, fields, x, plain, size=self.layout.size)

        results = in_blocks(block, together, np.asarray(x, float)[rows], np.full(len(rows), plain), *columns)
        first = np.flatnonzero(np.diff(rows, prepend=-1))
        count = np.diff(np.append(first, len(rows)))
        observation, slopes = (np.add.reduceat(np.asarray(item, float), first) for item in results)
        return observation / count[:, None], slopes / count[:, None, None]

    def whitened(self, observation: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (f - y)/sd (..., m), 0 where y is NaN, and the norm of what is subtracted (...,)."""
        seen = ~np.isnan(y)
        values, given = (np.where(seen, item, 0.0) / self.sd for item in (observation, y))
        return values - given, np.linalg.norm(np.abs(values) + np.abs(given), axis=-1)

    def linearise(self, y: np.ndarray, u: np.ndarray, **options: Any) -> Linearised:
        """Residuals (k, m), their slopes over u (k, m, p), observations (k, m) and the size of the numbers behind.

        Args:
            y: data (k, m).
            u: standard numbers (k, p).
            options: of `evaluate`.
        """
        observation, slopes = self.evaluate(u, **options)
        residual, size = self.whitened(observation, y)
        slopes = np.where(np.isnan(y)[..., None], 0.0, slopes) / self.sd[:, None]
        return residual, slopes, observation, size


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


def residuals(model: Model, given: Given, y: jax.Array, u: jax.Array) -> jax.Array:
    """Whitened residuals (f - y)/sd (m,) of the observation f, 0 where y is NaN."""
    seen, observation = ~jnp.isnan(y), flatten(model(values_of(given.population, u))).astype(y.dtype)
    values, y = (jnp.where(seen, item, 0) / given.sd for item in (observation, y))
    return values - y


Vector = Callable[[jax.Array], jax.Array]


def slopes(function: Vector, u: jax.Array, size: int) -> tuple[jax.Array, jax.Array]:
    """Value (m,) and Jacobian (m, p) of a function, by the cheaper of forward and reverse mode.

    A tangent costs about half of a cotangent. If a model supports only one of the two, that one is used.
    """
    ways = [forward, _reverse] if u.shape[0] <= 2 * size else [_reverse, forward]
    try:
        return ways[0](function, u)
    except (TypeError, ValueError, NotImplementedError):
        return ways[1](function, u)


def forward(function: Vector, u: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Value (m,) and Jacobian (m, p) of a function by tangents.

    Args:
        function: of u.
        u: where (p,).
    """
    push: Callable[[jax.Array], tuple[jax.Array, jax.Array]] = lambda tangent: jax.jvp(function, (u,), (tangent,))  # noqa: E731
    value, jacobian = jax.vmap(push, out_axes=(None, -1))(jnp.eye(u.shape[0], dtype=u.dtype))
    return value, jacobian


def _reverse(function: Vector, u: jax.Array) -> tuple[jax.Array, jax.Array]:
    value, pull = jax.vjp(function, u)
    return value, jax.vmap(lambda cotangent: pull(cotangent)[0])(jnp.eye(value.shape[0], dtype=value.dtype))


def parts_of(model: Model) -> tuple[Model, list[dict[str, Any]]]:
    """The model of a part and the fields of every part; most models are their only part.

    A model with a method `split` is the mean over parts of one structure, which one program evaluates. `split` returns
    the model of a part, a record, and which of its fields each part has; the first part is like all of them. Slopes of
    such a model cost little more than its values.
    """
    split: Callable[[], tuple[Model, list[dict[str, Any]]]] | None = getattr(model, "split", None)
    return split() if split else (model, [{}])


def program_of(model: Model) -> Hashable:
    """Key of the program of a model; equal for models that differ only in the fields of their parts."""
    base, fields = parts_of(model)
    if not fields[0]:
        return id(model)
    leaves, structure = jax.tree_util.tree_flatten_with_path(base)
    return structure, tuple(np.asarray(leaf).tobytes() for path, leaf in leaves if path[0].name not in fields[0])


@per_response(static=("size",))
def linearise(
    model: Model, population: Population, fields: dict[str, jax.Array], x: jax.Array, plain: jax.Array, *, size: int
) -> tuple[jax.Array, jax.Array]:
    """Observations (k, m) and their slopes over x (k, m, p) of several units.

    Args:
        model: of all of them.
        population: the prior.
        fields: of the model that differ from unit to unit (k, ...).
        x: standard numbers (k, p); values themselves where `plain` (k,).
        plain: which units.
        size: m.
    """

    def one(fields: dict[str, jax.Array], x: jax.Array, plain: jax.Array) -> tuple[jax.Array, jax.Array]:
        here: Any = model.replace(**fields) if fields else model  # type: ignore[attr-defined]

        def seen(x: jax.Array) -> jax.Array:
            values = jnp.where(plain, x, elementwise(population, jnp.where(plain, 0, x)))
            return flatten(here(population.fill(population.by_field(values))))

        return slopes(seen, x, size)

    return jax.vmap(one)(fields, x, plain)


@per_response()
def densities(model: Model, given: Given, y: jax.Array, z: jax.Array) -> jax.Array:
    """Phi (k,) at points z (k, n) for one unit y (m,); inf where the model is not finite."""

    def phi(z: jax.Array) -> jax.Array:
        value = jnp.sum(z**2) / 2 + half_square(residuals(model, given, y, mixed(given.mixing, z)), given.dof)
        return jnp.where(jnp.isfinite(value), value, jnp.inf)

    return jax.lax.map(phi, z, batch_size=DENSITIES)


def counted(name: str, value: int, least: int) -> None:
    """Raise ValueError for a value that is no count."""
    if integer(name, value) < least:
        raise ValueError(f"{name} = {value!r}: must be at least {least}")


def integer(name: str, value: int) -> int:
    """Return an integer; a ValueError names a value that is not one."""
    try:
        if isinstance(value, bool):
            raise TypeError
        return operator.index(value)
    except TypeError:
        raise ValueError(f"{name} = {value!r}: must be an integer") from None
