"""Requirements on outputs without errors, and the derivatives of these outputs to the numbers of the design."""

import dataclasses
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.population import Estimate, Population, Sampled
from rvjax.records import Array
from rvjax.response import Response, evaluate, per_response
from rvjax.tolerances.requirements.limits import Limits


@dataclasses.dataclass(frozen=True)
class Nominal(Limits):
    """Limits of an output without errors, which numbers of the design must keep; no unit counts.

    Attributes:
        lower: lower limit, unit of the output; None for none.
        upper: upper limit, unit of the output; None for none.
    """

    of_units: ClassVar[bool] = False
    of_sample: ClassVar[bool] = False
    exact: ClassVar[bool] = True
    most_failed: ClassVar[float] = math.inf
    judges: ClassVar[str] = "response"
    prefix: ClassVar[str] = "nominal_"

    lower: float | None = None  # type: ignore[assignment]
    upper: float | None = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name, none in (("lower", -math.inf), ("upper", math.inf)):
            if getattr(self, name) is None:
                object.__setattr__(self, name, none)
        super().__post_init__()

    def figure(self, sampled: Sampled) -> Estimate:
        """Raise ValueError: units do not decide it.

        Raises:
            ValueError: always.
        """
        raise ValueError("Nominal: limits an output without errors; give it to an allocation with variables")

    def text(self) -> str:
        """Name of the limited value."""
        return "without errors"


class NominalOutputs:
    """Outputs of a response without errors, and their derivatives to the numbers of the design."""

    def __init__(self, response: Response, names: tuple[str, ...]) -> None:
        self._response, self._names = response, names

    def at(self, population: Population) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Outputs by name, and {output: {number of the design: derivative}}."""
        if not self._names:
            return {}, {}
        values, slopes = _linearised(self._response, population, names=self._names)
        found = dict(zip(self._names, map(float, np.asarray(values))))
        by_number = {name: dict(zip(self._names, map(float, np.asarray(slope)))) for name, slope in slopes.items()}
        return found, {output: {n: by_number[n][output] for n in by_number} for output in self._names}


@per_response(static=("names",))
def _linearised(
    response: Response, population: Population, *, names: tuple[str, ...]
) -> tuple[jax.Array, dict[str, jax.Array]]:
    """Outputs (k,) without errors, and their derivatives (k,) by number of the design."""
    nothing = {name: jnp.zeros(tolerance.shape) for name, tolerance in population.active.items()}

    def outputs(values: dict[str, Array]) -> jax.Array:
        found, _ = evaluate(response, population.replace(values=values or population.values).fill(nothing))
        return jnp.stack([found[name] for name in names])

    free = {name: jnp.asarray(value, jnp.result_type(float)) for name, value in (population.values or {}).items()}
    return outputs(free), jax.jacrev(outputs)(free) if free else {}
