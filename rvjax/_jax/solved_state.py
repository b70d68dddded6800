"""A function in the place of its jaxpr: what `roots.solved` marks is read, or given and not computed again.

`roots.solved` gives what an iteration found a name in the program. `Marked` evaluates the jaxpr equation by equation:
`with_state` collects the named values, `from_state` takes them from a vector and skips all that only leads to them. So
gradients need no second solve. Gain: 256 units with transmission error and life take 17.5 instead of 26.4 CPU s in the
first call, 108 instead of 224 ms in a later one, with the same bits. `moving` reads off the jaxpr of the derivatives
which numbers a result depends on: no gain in time.
"""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal
from jax.interpreters import partial_eval

from rvjax.records import PyTree

SOLVED = "solved"
"""Name of a value that `roots.solved` marks in a program."""


class Marked(NamedTuple):
    """A traced function of arrays."""

    jaxpr: ClosedJaxpr
    tree: Any  # of its results

    @classmethod
    def of(cls, function: Callable[..., PyTree], *arguments: object) -> "Marked":
        """Trace a function for arguments of these shapes."""
        jaxpr, shapes = jax.make_jaxpr(function, return_shape=True)(*arguments)
        return cls(jaxpr, jax.tree.structure(shapes))

    def with_state(self, *arguments: object) -> tuple[PyTree, list[jax.Array]]:
        """Results, and what is marked, in the order of the program."""
        state: list[jax.Array] = []

        def kept(_: object, value: jax.Array) -> jax.Array:
            state.append(value)
            return value

        found = _evaluated(self.jaxpr, jax.tree.leaves(arguments), kept)
        return jax.tree.unflatten(self.tree, found), state

    def from_state(self, state: jax.Array, *arguments: object) -> PyTree:
        """Results with what is marked taken from a vector, and so without what leads there.

        Args:
            state: all numbers of `with_state`, one after the other.
            arguments: of the function.
        """
        place = 0

        def taken(kind: Any, _: None) -> jax.Array:
            nonlocal place
            part = state[place : place + np.prod(kind.shape, dtype=int)]
            place += part.size
            return part.reshape(kind.shape).astype(kind.dtype)

        return jax.tree.unflatten(self.tree, _evaluated(self.jaxpr, jax.tree.leaves(arguments), taken, given=True))


def moving(function: Callable[[PyTree], PyTree], numbers: Mapping[str, float]) -> set[str]:
    """Names of the numbers that move a result: those that the program of its derivatives reads.

    Args:
        function: of the numbers by name, to real numbers.
        numbers: where it can be traced.
    """
    given = {name: jnp.asarray(float(numbers[name])) for name in sorted(numbers)}
    closed = jax.make_jaxpr(lambda at, change: jax.jvp(function, (at,), (change,))[1])(given, given)
    _, read = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars))
    return {name for name, own in zip(given, read[len(given) :]) if own}


def _evaluated(
    closed: ClosedJaxpr, arguments: list[object], mark: Callable[[Any, Any], jax.Array], *, given: bool = False
) -> list[Any]:
    """Results of a jaxpr; `mark` (type, value) has a value for each mark, whose own is None where it is given."""
    jaxpr, known = closed.jaxpr, dict[Any, Any]()
    known |= dict(zip([*jaxpr.constvars, *jaxpr.invars], [*closed.consts, *arguments]))

    def read(variable: object) -> object:
        return variable.val if isinstance(variable, Literal) else known.get(variable)

    wanted = _wanted(jaxpr) if given else None
    for number, equation in enumerate(jaxpr.eqns):
        inner, values = _program(equation), [read(variable) for variable in equation.invars]
        if _is_mark(equation):
            found = [mark(equation.outvars[0].aval, values[0])]
        elif wanted is not None and number not in wanted:
            continue
        elif inner is not None and _has_marks(inner.jaxpr):
            found = _evaluated(inner, values, mark, given=given)
        else:
            bound = equation.primitive.bind(*values, **equation.primitive.get_bind_params(equation.params))
            found = bound if equation.primitive.multiple_results else [bound]
        known |= dict(zip(equation.outvars, found))
    return [read(variable) for variable in jaxpr.outvars]


def _wanted(jaxpr: Any) -> set[int]:
    """Numbers of the equations that the results need, apart from those that only lead to a mark."""
    needed, wanted = {v for v in jaxpr.outvars if not isinstance(v, Literal)}, set()
    for number, equation in reversed(list(enumerate(jaxpr.eqns))):
        inner = _program(equation)
        if _is_mark(equation) or (needed.isdisjoint(equation.outvars) and not (inner and _has_marks(inner.jaxpr))):
            continue
        wanted.add(number)
        needed |= {v for v in equation.invars if not isinstance(v, Literal)}
    return wanted


def _program(equation: Any) -> ClosedJaxpr | None:
    """The jaxpr of a call of `jax.jit`; None for any other equation."""
    return equation.params["jaxpr"] if equation.primitive.name in ("jit", "pjit") else None


def _is_mark(equation: Any) -> bool:
    return equation.primitive.name == "name" and equation.params["name"] == SOLVED


def _has_marks(jaxpr: Any) -> bool:
    programs = [_program(equation) for equation in jaxpr.eqns]
    return any(map(_is_mark, jaxpr.eqns)) or any(inner and _has_marks(inner.jaxpr) for inner in programs)
