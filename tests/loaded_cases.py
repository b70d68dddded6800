"""Designs and errors of the reference cases of the loaded model, in one shape each so that few programs compile."""

import json
from pathlib import Path

import jax
import numpy as np

from rvjax import Contact, CrankStage, CycloidStage, InvoluteStage, RVErrors, RVReducer, Stiffness
from rvjax.errors import PLACED

CASES = json.loads((Path(__file__).parent / "reference" / "loaded.json").read_text())["cases"]
NAMED = {case["name"]: case for case in CASES}

PARTS = {
    "involute": InvoluteStage,
    "cycloid": CycloidStage,
    "cranks": CrankStage,
    "stiffness": Stiffness,
    "contact": Contact,
}


def number(value):
    return np.asarray(value, float) if isinstance(value, list) else value


def unchecked(cls, numbers):
    """A record that its constructor would refuse, as a sampler makes it."""
    made = jax.tree.map(lambda leaf: leaf, cls(**{**numbers, "pin_circle_radius": 1.0}))
    object.__setattr__(made, "pin_circle_radius", numbers["pin_circle_radius"])
    return made


def design_of(case, **changes):
    """The reducer of a case; `changes` replace whole parts."""
    made = {}
    for name, cls in PARTS.items():
        numbers = {key: number(value) for key, value in case["design"][name].items()}
        try:
            made[name] = cls(**numbers)
        except ValueError:
            made[name] = unchecked(cls, numbers)
    return RVReducer(**{**made, **changes})


def errors_of(case, design, **changes):
    """The errors of a case in full shapes. A negative clearance, refused by the constructor, as a sampler gives it."""
    given = {name: number(value) for name, value in case["errors"].items()} | changes
    negative = {name: value for name, value in given.items() if np.ndim(value) == 0 and value < 0}
    full = dict.fromkeys(PLACED, 0.0) | {name: value for name, value in given.items() if name not in negative}
    errors = RVErrors.for_design(design, **full)
    leaves = {**vars(errors), **negative}
    made = jax.tree.map(lambda leaf: leaf, errors)
    for name, value in leaves.items():
        object.__setattr__(made, name, value)
    return made


def swapped_frame(vectors):
    """x, y vectors reversed."""
    return -np.asarray(vectors)
