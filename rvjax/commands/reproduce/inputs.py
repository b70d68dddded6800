"""What `rvjax reproduce` reads: one option."""

import argparse
from dataclasses import dataclass


@dataclass(frozen=True)
class Inputs:
    """What the command needs.

    Attributes:
        notes: print the reading or the reason under each value.
    """

    notes: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name."""
    return Inputs(options.notes)
