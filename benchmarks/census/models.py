"""All models of the census, in groups that share the number of inputs.

The one place where a family joins: its own module makes a `cases.Model`, a loop here selects the sampled cases.
"""

from collections.abc import Iterator

from benchmarks.census.cases import Model
from benchmarks.census.dynamic_error import displaced
from benchmarks.census.dynamics import vibration
from benchmarks.census.linkage import linkage
from benchmarks.census.loaded import machine
from benchmarks.census.mesh import mesh
from benchmarks.census.play import play
from benchmarks.census.reducer import reducer, turn
from rvjax.lost_motion.outputs import PROFILES


def models() -> Iterator[Model]:
    """All of them."""
    for cranks, branch, closure in (
        ("free", "open", "newton"),
        ("free", "open", "closed_form"),
        ("free", "crossed", "newton"),
        ("free", "crossed", "closed_form"),
        ("phase_locked", "open", "newton"),
        ("phase_locked", "open", "closed_form"),
        ("geared", "open", "newton"),
    ):
        yield linkage(cranks, branch, closure)
    for cranks, discs in ((2, 1), (2, 2), (3, 1), (8, 1)):
        yield reducer(cranks, discs)
    for cranks, discs, angles in ((2, 2, 64), (3, 1, 7)):
        yield turn(cranks, discs, angles)
    for profile in PROFILES:
        for teeth in (2, 39, 200):
            yield play(profile, teeth)
    for contact in ("hertz", "linear", "palmgren"):
        for teeth in (2, 25, 200) if contact == "hertz" else (2, 25):
            yield mesh(contact, teeth)
    for stage, cranks, discs, method in (
        ("planetary", 4, 3, "first_order"),
        ("cycloid", 3, 2, "first_order"),
        ("planetary", 2, 1, "first_order"),
        ("cycloid", 8, 8, "first_order"),
        ("planetary", 3, 3, "harmonic_balance"),
        ("planetary", 2, 2, "harmonic_balance"),
    ):
        yield vibration(stage, cranks, discs, method)
    for cranks, discs in ((2, 2), (3, 3)):
        yield displaced(cranks, discs)
    for layout in (
        ("hertz", 2, 2, 39),
        ("hertz", 3, 2, 24, "floating"),
        ("hertz", 2, 1, 99, "fixed", "floating"),
        ("hertz", 4, 3, 5, "fixed", "fixed", True),
        ("linear", 2, 2, 39),
        ("linear", 4, 3, 24, "floating", "floating", True),
        ("palmgren", 2, 2, 39),
        ("palmgren", 3, 1, 5, "floating", "floating"),
    ):
        yield machine(*layout)
