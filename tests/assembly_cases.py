"""Independent cases of assembly and compensation: optima over all permutations, closed forms."""

import json
from pathlib import Path

CASES = json.loads((Path(__file__).parent / "reference" / "assembly.json").read_text())["cases"]


def cases(kind):
    """Of one kind."""
    return [case for case in CASES if case["kind"] == kind]
