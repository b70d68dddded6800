"""Published values, computed now."""

import sys

from rvjax import published
from rvjax.commands.reproduce.inputs import Inputs
from rvjax.published import Comparison


def compute(inputs: Inputs) -> list[Comparison]:
    """Compare every published value with the computed value."""
    return published.reproduce(say=lambda text: print(text, file=sys.stderr, flush=True))
