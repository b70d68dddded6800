"""Linear low-fidelity response: value and derivatives of a response at the mean errors."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Population
from rvjax.records import Array, PyTree, Record, field, record, text
from rvjax.response import Outcome, Response, per_response
from rvjax.status import Status, succeeded, worst


@record
class Linearised(Record):
    """errors -> value + slope . d + curvature . d^2/2 with d = errors - mean, and what is read off that.

    Its numbers are traced: one compiled program serves every linearised response of the same structure.
    """

    value: PyTree = field("-", "numbers or arrays at the mean errors, as the response gives them", kind="record")
    slope: PyTree = field("-", "their derivatives to all active elements, the last axis", kind="record")
    curvature: PyTree = field(
        "-", "their second derivatives to each element alone, like `slope`; or None", kind="record"
    )
    mean: Array = field("-", "mean error of each active element", shape=("elements",))
    fields: tuple[str, ...] = text("names of the active fields, in the order of their elements")
    then: Any = text("function of the values; None for themselves", default=None)

    def __call__(self, errors: PyTree) -> PyTree:
        """The values of one unit."""
        leaves = jax.tree_util.tree_flatten_with_path(errors)[0]
        given = {jax.tree_util.keystr(path, simple=True, separator="."): leaf for path, leaf in leaves}
        d = jnp.concatenate([jnp.ravel(jnp.asarray(given[name])) for name in self.fields]) - self.mean
        found = jax.tree.map(lambda value, slope: value + slope @ d, self.value, self.slope)
        if self.curvature is not None:
            found = jax.tree.map(lambda value, bent: value + bent @ (d * d) / 2, found, self.curvature)
        return found if self.then is None else self.then(found)


def linearised(
    response: Response,
    tolerances: PyTree,
    *,
    curvature: bool = False,
    then: Callable[[Any], Any] | None = None,
) -> Linearised:
    """Response by its value and derivatives at the mean errors: low-fidelity, accurate for small errors.

    A peak-to-peak value has a kink where its errors vanish, and no derivative there that predicts its
    neighbourhood. Linearise the curve and read the peak off the line: let the response return the curve, an array,
    and give `then=jnp.ptp`.

    Args:
        response: pure function of the errors of one unit; with `then` its values may be arrays.
        tolerances: record or dict with a `Tolerance` or None in each field.
        curvature: also take the second derivatives to each error alone, not the mixed ones.
        then: pure function of the linearised values, one and the same for all responses that should share a program.

    Returns:
        `Linearised`, a response.

    Raises:
        ValueError: the response fails, or has no finite derivative, at the mean errors.
    """
    population = Population.of(tolerances)
    means = {name: np.broadcast_to(np.asarray(t.moments()[0], float), t.shape) for name, t in population.active.items()}
    if not means:
        raise ValueError("tolerances: no field has a Tolerance")
    flat = jnp.asarray(np.concatenate([m.ravel() for m in means.values()]), jnp.result_type(float))
    (value, status), slope, bent = _taylor(response, population, flat, curvature=curvature)
    if not bool(succeeded(status)):
        raise ValueError(f"response: status {Status(int(status)).name} at the mean errors, no place to linearise")
    for what, tree in (("value", value), ("derivative", slope), ("second derivative", bent)):
        if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree)):
            raise ValueError(f"response: {what} at the mean errors is not finite, no place to linearise")
    return Linearised(value, slope, bent, flat, tuple(population.active), then)


@per_response(static=("curvature",))
def _taylor(
    response: Response, population: Population, mean: Array, *, curvature: bool
) -> tuple[tuple[PyTree, Array], PyTree, PyTree | None]:
    """Values and status, derivatives (*shape, elements), and second derivatives or None."""

    def function(vector: Array) -> tuple[PyTree, Array]:
        result, status = response(population.fill(population.by_field(vector))), jnp.int32(int(Status.CONVERGED))
        if isinstance(result, Outcome):
            result, status = result.value, worst(jnp.asarray(result.status)).astype(jnp.int32)
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, mean.dtype), result), status

    values = lambda vector: function(vector)[0]  # noqa: E731
    numbers = sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(values, mean)))
    slope = (jax.jacrev if numbers < mean.size else jax.jacfwd)(values)(mean)
    if not curvature:
        return function(mean), slope, None

    def along(direction: Array) -> PyTree:
        first = lambda x: jax.jvp(values, (x,), (direction,))[1]  # noqa: E731
        return jax.jvp(first, (mean,), (direction,))[1]

    bent = jax.vmap(along, out_axes=-1)(jnp.eye(mean.size, dtype=mean.dtype))
    return function(mean), slope, bent
