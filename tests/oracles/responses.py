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


@record
class Made(Record):
    """Response of many kinds: a line of three errors, a square, a number d, a corner, steps, units that fail.

    y = sum s_j d^p_j e_j + bend e_b^2 + base + shift (d - 1) + bow (d - 1)^2, then sqrt(corner^2 + y^2), whole steps.
    """

    slopes: Any = field("-", "of errors a, b, c", shape=(3,))
    powers: Any = field("-", "of d in each slope", shape=(3,), default=0.0)
    base: Any = field("-", "without errors", default=0.0)
    bend: Any = field("-", "of the square of b", default=0.0)
    shift: Any = field("-", "of d - 1", default=0.0)
    bow: Any = field("-", "of its square", default=0.0)
    corner: Any = field("-", "smallest size of y; 0 for none", default=0.0)
    step: Any = field("-", "to whole ones of which y is rounded up; 0 for none", default=0.0)
    edge: Any = field("-", "largest |b| of a unit that can be assembled", default=1e9)
    costly: bool = text("whether units are few", default=False)

    def __call__(self, errors: PyTree, values: PyTree = None) -> Outcome:
        """Value of y, b and the number of a unit."""
        e = jnp.stack([errors[name] for name in "abc"])
        d = jnp.asarray(values["d"] if values else 1.0, e.dtype)
        y = jnp.sum(jnp.asarray(self.slopes) * d ** jnp.asarray(self.powers) * e) + self.bend * e[1] ** 2
        y = y + self.base + self.shift * (d - 1) + self.bow * (d - 1) ** 2
        y = jnp.where(self.corner > 0, jnp.sqrt(self.corner**2 + y**2 + 1e-300), y)
        y = jnp.where(self.step > 0, jnp.ceil(y / jnp.where(self.step > 0, self.step, 1.0)) * self.step, y)
        status = jnp.where(jnp.abs(e[1]) > self.edge, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
        return Outcome({"y": y, "b": e[1], "d": d + 0.0 * e[0]}, status)
