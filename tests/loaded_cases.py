"""Designs and errors of the reference cases of the loaded model, in one shape and type each: few programs compile.

`solve` is one program for each law, `solve_many` one for cases next to each other.
"""

import contextlib
import json
import os
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from rvjax import Contact, CrankStage, CycloidStage, InvoluteStage, RVErrors, RVReducer, Status, Stiffness, loaded
from rvjax.errors import described
from rvjax.loaded.equilibrium import check_input
from rvjax.loaded.system import Layout

equilibrium = sys.modules["rvjax.loaded.equilibrium"]  # a function hides it

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


def plain(tree):
    """Scalars as floats, as constructors leave them, the rest as arrays, for JAX compiles anew for other types."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, float) if np.ndim(leaf) else float(leaf), tree)


@contextlib.contextmanager
def newton_alone():
    """What is traced here lacks the interior point method, which few cases need: a fifth of the compilation.

    The long profile has it in every program. A decorator too."""
    with pytest.MonkeyPatch.context() as patch:
        if os.environ.get("HYPOTHESIS_PROFILE") != "long":
            patch.setattr(Layout.__new__, "__defaults__", (False,))
        yield


def solve(design, errors, angle, torque, **methods):
    """The equilibrium, by one program for each shape; conditions as studies give them.

    Linear pins get equal supports, which add nothing to the mesh stiffness: the same program takes unequal ones.
    """
    if methods.get("contact") == "linear":
        design = supported(design, 1e9)
    design, errors, angle, torque = plain((design, errors, angle, torque))
    return loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque, **methods)


def supported(design, stiffness):
    """The design with a support at each pin, where it has none."""
    contact = design.contact
    if contact.pin_support is None:
        contact = contact.replace(pin_support=np.full(design.cycloid.pin_count, stiffness))
    return design.replace(contact=contact)


def solve_many(cases):
    """Equilibria of cases (design, errors, angle, torque), every number their own, by one program for each layout.

    Hertzian pins without a support get rigid ones.
    """
    alike = plain([(supported(design, 1e30), *rest) for design, *rest in cases])
    found = []
    for first in range(0, len(alike), LANES):
        some = alike[first : first + LANES]
        padded = [*some, *some[-1:] * (LANES - len(some))]
        lanes = solve_lanes(*jax.tree.map(lambda *leaves: np.stack(leaves), *padded))
        found.append(jax.device_get(lanes))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(alike)], *found)


LANES = 64


@jax.jit
@jax.vmap
def solve_lanes(design, errors, angle, torque):
    """Equilibria of cases that share nothing."""
    return loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque)


def by_newton(design, errors, angle, torque, contact="hertz"):
    """`loaded.equilibrium` inside a program, without the interior point method: two thirds of the compilation."""
    layout = check_input(design, errors, contact, "fixed", "fixed")._replace(interior=False)
    return equilibrium._equilibrium(layout, design, errors, angle, torque)


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
    full = dict.fromkeys(described(RVErrors, "placed"), 0.0) | {
        name: value for name, value in given.items() if name not in negative
    }
    errors = RVErrors.for_design(design, **full)
    leaves = {**vars(errors), **negative}
    made = jax.tree.map(lambda leaf: leaf, errors)
    for name, value in leaves.items():
        object.__setattr__(made, name, value)
    return made


def assert_same(case, due, place):
    """Accuracy at loads near rated: rounding, 1e-15, times a condition of 1e3, with a margin of a thousand. The
    stiffness jumps where a contact closes and moves with every force, a thousand times as far."""
    assert int(case.info.status) == int(due.info.status) == Status.CONVERGED
    np.testing.assert_allclose(case.error, due.error, rtol=1e-9, err_msg=str(place))
    largest = np.max(due.pins)
    for name in ("pins", "disc_bearing", "support_bearing", "gear"):
        np.testing.assert_allclose(getattr(case, name), getattr(due, name), rtol=0, atol=1e-9 * largest)
    np.testing.assert_allclose(case.stiffness, due.stiffness, rtol=1e-6, err_msg=str(place))


def at(found, place):
    """One case of a batch."""
    return jax.tree.map(lambda leaf: leaf[place], found)
