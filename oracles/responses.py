"""Responses of tests as records: a program that was compiled for one serves all coefficients of its kind.

A plain function has a program of its own for each size of a call. Tests of plain functions keep them.
"""

from typing import Any

import jax.numpy as jnp

from rvjax.records import PyTree, Record, field, record, text
from rvjax.status import Status
from rvjax.tolerances import Outcome


@record
class Linear(Record):
    """Sum of errors, and of numbers of the design, times their slopes: plain, or one for each output."""

    slopes: PyTree = field("-", "{name: slope}, or {output: {name: slope}}", kind="record")

    def __call__(self, errors: PyTree, values: PyTree = None) -> Any:
        """Value of a unit, or values by output."""
        given = errors | (values or {})
        if isinstance(next(iter(self.slopes.values())), dict):
            return {output: _sum(slopes, given) for output, slopes in self.slopes.items()}
        return _sum(self.slopes, given)


def _sum(slopes: dict[str, Any], given: PyTree) -> Any:
    return sum(slope * given[name] for name, slope in slopes.items())


@record
class Largest(Record):
    """The largest of several sums for each output: |b| is that of b and -b."""

    sums: PyTree = field("-", "{output: ({error: slope}, ...)}", kind="record")

    def __call__(self, errors: PyTree) -> dict[str, Any]:
        """Values of a unit by output."""
        return {
            output: jnp.max(jnp.stack([_sum(slopes, errors) for slopes in several]))
            for output, several in self.sums.items()
        }


@record
class Failing(Record):
    """A sum of errors that units beyond an edge do not have."""

    slopes: dict[str, Any] = field("-", "{error: slope}", kind="record")
    edges: dict[str, Any] = field("-", "{error: largest size of a unit that can be assembled}", kind="record")

    def __call__(self, errors: PyTree) -> Outcome:
        """Value and status of a unit."""
        lost = jnp.any(jnp.stack([jnp.abs(errors[name]) > edge for name, edge in self.edges.items()]))
        status = jnp.where(lost, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
        return Outcome(_sum(self.slopes, errors), status)


@record
class Lever(Record):
    """A lever whose length is a number of the design: y = length a + b/length, and its size."""

    unit: Any = field("m", "unit in which the length is given", default=1.0)
    costly: bool = text("whether units are followed", default=False)

    def __call__(self, errors: PyTree, values: PyTree) -> dict[str, Any]:
        """Values of a unit."""
        length = self.unit * values["length"]
        return {"y": length * errors["a"] + errors["b"] / length, "size": 10.0 * length}
