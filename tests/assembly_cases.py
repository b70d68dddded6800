"""Independent cases of assembly and compensation: optima over all permutations, closed forms; parts of tests."""

import json
from pathlib import Path

from rvjax.assembly import Kind, Part
from rvjax.tolerances import Tolerance

CASES = json.loads((Path(__file__).parent / "reference" / "assembly.json").read_text())["cases"]


def cases(kind):
    """Of one kind."""
    return [case for case in CASES if case["kind"] == kind]


def kind(values, **options):
    return Kind([Part(f"p{i}", {"x": value}) for i, value in enumerate(values)], **options)


def square(parts, index):
    return (parts["a"]["x"] + parts["b"]["x"]) ** 2


UNIT = Tolerance(-3.0, 3.0)  # N(0, 1)


def measured(truth, noise, sd, population=UNIT):
    population = None if population is None else {"x": population}
    parts = [Part(i, {"x": float(x + e)}, sd) for i, (x, e) in enumerate(zip(truth, noise))]
    return Kind(parts, population=population)
