"""Responses of tests as records: a program that was compiled for one serves all coefficients of its kind.

A plain function has a program of its own for each size of a call. Tests of plain functions keep them.
"""

from typing import Any

from rvjax.records import PyTree, Record, field, record, text


@record
class Linear(Record):
    """Sum of errors, and of numbers of the design, times their slopes: plain, or one for each output."""

    slopes: PyTree = field("-", "{name: slope}, or {output: {name: slope}}", kind="record")

    def __call__(self, errors: PyTree, values: PyTree = None) -> Any:
        """Value of a unit, or values by output."""
        given = errors | (values or {})
        total = lambda slopes: sum(slope * given[name] for name, slope in slopes.items())  # noqa: E731
        if isinstance(next(iter(self.slopes.values())), dict):
            return {output: total(slopes) for output, slopes in self.slopes.items()}
        return total(self.slopes)


@record
class Lever(Record):
    """A lever whose length is a number of the design: y = length a + b/length, and its size."""

    unit: Any = field("m", "unit in which the length is given", default=1.0)
    costly: bool = text("whether units are followed", default=False)

    def __call__(self, errors: PyTree, values: PyTree) -> dict[str, Any]:
        """Values of a unit."""
        length = self.unit * values["length"]
        return {"y": length * errors["a"] + errors["b"] / length, "size": 10.0 * length}
