"""A response is a pure function of the errors of one unit; here it meets a batch of units.

It returns a scalar, a dict or record of scalars, or an `Outcome` that names why a unit failed.
"""

import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from rvjax.records import Record, field, record
from rvjax.status import Status, succeeded, worst
from rvjax.tolerances.population.layout import deviations, drawn, layout

BLOCK = 16384
"""Units at once where nobody chose: the same everywhere, so that a response is compiled for it once; temporaries of
a response over many angles then stay near the cache."""

PLAIN = ""
"""Name of the only scalar of a response that returns no dict."""

Response = Callable[[Any], Any]


@record
class Outcome(Record):
    """A response with the reason of its failure.

    A unit fails if any status is no success (the first by `rvjax.status.PRECEDENCE` counts) or any
    value is not finite; a bare nan counts as NONFINITE.
    """

    value: Any = field("-", "scalar, or dict or record of scalars", kind="record")
    status: Any = field("-", "`Status` values, any shape (angles, discs)", kind="integer")


def evaluate(response: Response, errors: Any) -> tuple[dict[str, jax.Array], jax.Array]:
    """Values by name and the status of one unit.

    Raises:
        ValueError: a value that is not one number.
    """
    result = response(errors)
    status = jnp.int32(int(Status.CONVERGED))
    if isinstance(result, Outcome):
        status, result = worst(jnp.asarray(result.status)).astype(jnp.int32), result.value
    values = {}
    for name, value in _named(result).items():
        number = jnp.asarray(value)
        if number.shape or not jnp.issubdtype(number.dtype, jnp.number):
            shown = f"response[{name!r}]" if name else "response"
            raise ValueError(f"{shown}: must be one real number per unit, got shape {number.shape} {number.dtype}")
        values[name] = number.astype(jnp.result_type(float, number))
    finite = jnp.all(jnp.stack([jnp.isfinite(number) for number in values.values()]))
    return values, jnp.where(succeeded(status) & ~finite, jnp.int32(int(Status.NONFINITE)), status)


def _named(result: Any) -> dict[str, Any]:
    if isinstance(result, Record):
        result = {path[-1].name: leaf for path, leaf in jax.tree_util.tree_flatten_with_path(result)[0]}
    if not isinstance(result, Mapping):
        return {PLAIN: result}
    if not result:
        raise ValueError("response: returned no value")
    return dict(result)


def like_response(by_name: Mapping[str, Any]) -> Any:
    """Results by name in the response's structure: plain for a scalar response, else a dict."""
    return by_name[PLAIN] if set(by_name) == {PLAIN} else dict(by_name)


def by_response(given: Any, names: tuple[str, ...], kind: type, argument: str) -> dict[str, Any]:
    """Bring requirements (one, a dict, or None) to a dict by response name.

    Raises:
        ValueError: a name the response does not have, or something of another type.
    """
    if given is None:
        return {}
    if not isinstance(given, Mapping):
        if names != (PLAIN,):
            raise ValueError(f"{argument}: the response has the names {', '.join(names)}; give a dict of them")
        given = {PLAIN: given}
    for name, item in given.items():
        if name not in names:
            have = ", ".join(names) if names != (PLAIN,) else "only one scalar; give its value itself"
            raise ValueError(f"{argument}: {name!r} is no name of the response; it has {have}")
        if item is not None and not isinstance(item, kind):
            raise ValueError(f"{argument}[{name!r}] = {item!r}: must be a {kind.__name__}")
    return {name: item for name, item in given.items() if item is not None}


@functools.partial(jax.jit, static_argnums=0)
def respond(response: Response, tolerances: Any, z: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
    """Values (n,) by name and status (n,) of the units whose random numbers are z (numbers, n)."""
    parts = layout(tolerances)
    errors = deviations(parts, z)
    one = lambda active: evaluate(response, parts.errors(active))  # noqa: E731
    return jax.vmap(one, in_axes=-1, axis_size=z.shape[-1])(errors)


def respond_units(
    response: Response, tolerances: Any, key: jax.Array, start: int, *, count: int
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Values and status of units start .. start + count - 1; one compilation whatever the start.

    Drawing is a program of its own, so that the response is compiled once for one number of units, whoever asks.
    """
    return respond(response, tolerances, drawn(tolerances, key, jnp.uint32(start), count=count))


def response_names(response: Response, tolerances: Any) -> tuple[str, ...]:
    """Names of the response's values, found without computing any."""
    parts = layout(tolerances)
    z = jax.ShapeDtypeStruct((parts.numbers, 1), jnp.result_type(float))
    return tuple(jax.eval_shape(functools.partial(respond, response), parts.replace({}), z)[0])
