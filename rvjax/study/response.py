"""What a question needs: from the outputs asked for to one function of the errors that computes just those.

Statistics and allocation see the response `errors -> Outcome` and know nothing of gears; models know no statistics.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import jax
import jax.numpy as jnp

from rvjax import models
from rvjax.levels.choice import Choice
from rvjax.outputs import Solved
from rvjax.records import Record, field, record, text
from rvjax.status import Status, succeeded, worst
from rvjax.tolerances import Outcome

Settings = tuple[tuple[str, Any], ...]


@record
class Response(Record):
    """errors -> Outcome({output: value}, status) of one unit, with no output but those asked for.

    Its numbers are those of the design: a program that was compiled for one question serves every design of its kind.
    """

    design: Any = field("-", "the reducer", kind="record")
    outputs: tuple[str, ...] = text("names")
    conditions: Any = text("how the reducer runs")
    levels: tuple[tuple[str, Settings, str], ...] = text("(output, settings, precision) where a level was chosen")

    @classmethod
    def of(
        cls, design: Any, outputs: Sequence[str], conditions: Any, choices: Mapping[str, Choice] | None = None
    ) -> Self:
        """The response of a question.

        Args:
            design: the reducer.
            outputs: names of outputs of this kind of design.
            conditions: how the reducer runs.
            choices: levels from `levels.choose`, by output; an output without one is computed as `conditions` say.

        Raises:
            ValueError: an output that does not exist, or that needs a condition which is not given.
        """
        known = models.kind(design).outputs
        for name in outputs:
            if name not in known:
                raise ValueError(f"unknown response {name!r}; there are {', '.join(known)}")
            for missing in (need for need in known[name].needs if getattr(conditions, need) is None):
                raise ValueError(f"conditions.{missing} is missing: {name} needs it")
        chosen = tuple((c.output, c.settings, c.precision) for c in (choices or {}).values())
        return cls(design, tuple(outputs), conditions, chosen)

    def __call__(self, errors: Any) -> Outcome:
        """Values and the worst status of one unit.

        Args:
            errors: of the design.
        """
        found = {name: self._one(name, errors) for name in self.outputs}
        statuses = jnp.stack([jnp.asarray(status) for _, status in found.values()])
        return Outcome({name: value for name, (value, _) in found.items()}, worst(statuses))

    def _one(self, name: str, errors: Any) -> Solved:
        output = models.kind(self.design).outputs[name]
        level = next((level for level in self.levels if level[0] == name), None)
        if level is None:
            return output.evaluate(self.design, errors, self.conditions)
        _, settings, precision = level
        own = replace(self.conditions, **dict(settings))
        design, rough = jax.tree.map(lambda leaf: jnp.asarray(leaf, precision), (self.design, errors))
        value, status = output.evaluate(design, rough, own)
        return value.astype(jnp.result_type(float, *jax.tree.leaves(errors))), status


_status = jax.jit(lambda response, errors: response(errors).status)


def check_nominal(response: Callable[[Any], Outcome], errors: Any) -> None:
    """Refuse a question whose error-free unit already fails.

    Args:
        response: of the question.
        errors: of the unit.

    Raises:
        ValueError: names the status.
    """
    status = _status(response, errors)
    if not succeeded(status):
        raise ValueError(f"the unit without errors cannot be solved: {Status(int(status)).name}")
