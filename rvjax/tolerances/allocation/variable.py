"""Free numbers of a design.

Mid-points of limits that may move: they belong to the nominal value, such as a modification of the profile.
"""

import dataclasses
import inspect
import math
from collections.abc import Callable, Mapping, Sequence

import jax
import jax.numpy as jnp
from jax.interpreters import partial_eval

from rvjax._jax.checks import number
from rvjax.population import Population, Tolerance
from rvjax.records import Array
from rvjax.response import Response, evaluate


@dataclasses.dataclass(frozen=True)
class Middle:
    """Limits of the mid-point of an error's limits.

    Attributes:
        lower: least mid-point, unit of the error.
        upper: largest mid-point.
        scale: cost of moving by one unit of the error (SI) from the given mid-point, either way; 0 by default.
    """

    lower: float
    upper: float
    scale: float = 0.0

    def __post_init__(self) -> None:
        for name in ("lower", "upper", "scale"):
            number(f"Middle.{name}", getattr(self, name))
        if not (math.isfinite(self.lower) and math.isfinite(self.upper) and self.lower <= self.upper):
            raise ValueError(f"Middle.lower = {self.lower!r}, upper = {self.upper!r}: must be finite and ascend")
        if not (math.isfinite(self.scale) and self.scale >= 0):
            raise ValueError(f"Middle.scale = {self.scale!r}: must be finite and not negative")


def check_middles(middles: Mapping[str, Middle], active: Mapping[str, Tolerance]) -> None:
    """Raise ValueError for mid-points that cannot move.

    Raises:
        ValueError: names the field.
    """
    for name, item in middles.items():
        if name not in active:
            raise ValueError(f"middles: {name!r} has no tolerance; these have: {', '.join(active)}")
        if not isinstance(item, Middle):
            raise ValueError(f"middles: {name} = {item!r} must be a Middle")
        law = active[name].law
        if law.of_vectors or law.name == "empirical":
            raise ValueError(f"middles: {name}: the distribution {law.name} does not move with its limits")


@dataclasses.dataclass(frozen=True)
class Variable:
    """A number of the design that an allocation may choose.

    Attributes:
        lower: least value, SI.
        upper: largest value, SI.
        start: value from which the search begins; None takes the mid-point of the range, or the middle of the list.
        cost: own cost by the value, a function; None for none.
        among: the values that it may take; empty for all between the bounds.
    """

    lower: float
    upper: float
    start: float | None = None
    cost: Callable[[float], float] | None = None
    among: Sequence[float] = ()

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            object.__setattr__(self, name, _finite(name, getattr(self, name)))
        if self.lower > self.upper:
            raise ValueError(f"Variable.lower = {self.lower:.6g}: lies above upper = {self.upper:.6g}")
        if self.start is not None:
            object.__setattr__(self, "start", _finite("start", self.start))
            self._inside("start", self.first)
        if self.cost is not None and not callable(self.cost):
            raise ValueError(f"Variable.cost = {self.cost!r}: must be a function of the value")
        if self.among is None or (not isinstance(self.among, tuple) and len(self.among) == 0):
            raise ValueError("Variable.among: the list is empty; leave it out where every value will do")
        object.__setattr__(self, "among", tuple(sorted({_finite("among", value) for value in self.among})))
        for value in self.among:
            self._inside("among", value)

    def _inside(self, name: str, value: float) -> None:
        if not self.lower <= value <= self.upper:
            between = f"{self.lower:.6g} and {self.upper:.6g}"
            raise ValueError(f"Variable.{name} = {value:.6g}: lies outside the bounds {between}")

    @property
    def first(self) -> float:
        """Value from which the search begins."""
        if self.start is not None:
            return self.start
        return self.among[len(self.among) // 2] if self.among else (self.lower + self.upper) / 2

    @property
    def free(self) -> bool:
        """True if it can change between its bounds."""
        return self.upper > self.lower and len(self.among) != 1

    def own_cost(self, value: float) -> float:
        """Cost of the number.

        Args:
            value: of the number, SI.
        """
        return 0.0 if self.cost is None else float(self.cost(value))


def _finite(name: str, value: float) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"Variable.{name} = {value!r}: must be a number") from None
    if not math.isfinite(number):
        raise ValueError(f"Variable.{name} = {number!r}: must be finite")
    return number


def with_values(response: Response, population: Population, variables: Mapping[str, Variable]) -> Population:
    """The population with the numbers of the design at their starts.

    Raises:
        ValueError: what is no variable, a response that takes no values, or a variable that nothing reads.
    """
    for name, item in variables.items():
        if not isinstance(item, Variable):
            raise ValueError(f"variables: {name} = {item!r}: must be a Variable")
    if not variables:
        raise ValueError("objective: without variables nothing of its cost can be chosen")
    try:
        inspect.signature(response).bind(None, {})
    except TypeError:
        raise ValueError("response: takes no values; with variables it is called as response(errors, values)") from None
    there = population.replace(values={name: item.first for name, item in variables.items()})
    idle = _unread(response, there)
    if idle:
        raise ValueError(f"variables: {idle[0]}: the response does not read it")
    return there


def _unread(response: Response, population: Population) -> list[str]:
    """Numbers of the design that no output depends on."""
    values = {name: jnp.asarray(value, jnp.result_type(float)) for name, value in population.values.items()}
    nothing = {name: jnp.zeros(tolerance.shape) for name, tolerance in population.active.items()}

    def outputs(values: dict[str, Array]) -> list[Array]:
        return list(evaluate(response, population.replace(values=values).fill(nothing))[0].values())

    program = jax.make_jaxpr(outputs)(values).jaxpr
    _, used = partial_eval.dce_jaxpr(program, [True] * len(program.outvars))
    return [name for name, read in zip(sorted(values), used) if not read]
