"""Inputs of `rvjax reproduce`: one option."""

import argparse
from dataclasses import dataclass


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        notes: print the reading or the reason under each value.
    """

    notes: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name."""
    return Inputs(options.notes)
