"""Torsional stiffness that makers publish for each size of an RV reducer, and that of similar reducers.

Two numbers of the model are calibrated on one size: the springs of the RV-40E (`rv-40e-whole`, assumed) get a common
factor. Every other size is the RV-40E with all lengths times the cube root of the ratio of rated torques, and with the
springs that follow them by the scaling laws of another size. Teeth and cranks of the other sizes are those of the
RV-40E.
"""

import math
from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from rvjax import loaded, lost_motion, study, tolerances
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.records import PyTree
from rvjax.units import arcmin

TORQUE = {"20e": 167.0, "40e": 412.0, "42n": 412.0, "80e": 784.0, "110e": 1078.0, "160e": 1568.0, "320e": 3136.0}
"""Rated torque at 15 r/min, N m."""
WEIGHT = {"20e": 4.7, "40e": 9.3, "80e": 13.1, "110e": 17.4, "160e": 26.4, "320e": 44.3}
"""Published weight, kg."""
STEEL = 7850.0
"""Density, kg/m3."""
PUBLISHED = 108.0
"""Torsional stiffness of the RV-40E, N m/arcmin: what the springs are calibrated on."""
LENGTHS = ("cycloid.pin_circle_radius", "involute.module")
"""Lengths that all other numbers follow by the scaling laws of another size, as in `rvjax init`."""


@cache
def _study() -> study.Study:
    return study.load("rv-40e-whole", solve=False)


def similar(torque: float) -> RVReducer:
    """RV-40E with all lengths times the cube root of the ratio of torques: equal stresses.

    Args:
        torque: rated torque of the size, N m.
    """
    ratio = (torque / TORQUE["40e"]) ** (1 / 3)
    base = _study().design
    design: RVReducer = study.scaled(base, {path: ratio * study.number_at(base, path) for path in LENGTHS}, whole=True)
    return design


def _secant(design: RVReducer, torque: float) -> float:
    """Between half and full rated torque, N m/arcmin; without errors of parts."""
    curve = loaded.torsion(design, RVErrors(), input_angle=0.0, rated_torque=torque)
    return float(curve.stiffness) * arcmin


@cache
def factor() -> float:
    """Factor on the springs of the RV-40E with which it is as stiff as published."""
    log = brentq(
        lambda x: _secant(similar(TORQUE["40e"]).stiffer(math.exp(x)), TORQUE["40e"]) - PUBLISHED, -3, 3, xtol=1e-6
    )
    return math.exp(log)


def stiffness(size: str) -> float:
    """Torsional stiffness of a size, N m/arcmin, with the springs calibrated on the RV-40E.

    Args:
        size: of `TORQUE`.
    """
    return _secant(similar(TORQUE[size]).stiffer(factor()), TORQUE[size])


def disc_mass(size: str) -> float:
    """Mass of the discs of a similar reducer, steel without holes, kg.

    Args:
        size: of `TORQUE`.
    """
    design = similar(TORQUE[size])
    assert design.contact is not None
    radius = float(design.cycloid.pin_circle_radius - design.cycloid.pin_radius)
    return design.cycloid.disc_count * math.pi * radius**2 * float(design.contact.face_width) * STEEL


def _weights() -> bool:
    """True if every size weighs two to six times its discs."""
    return all(2 < WEIGHT[size] / disc_mass(size) < 6 for size in WEIGHT)


def _lost_motion() -> bool:
    """True if nineteen of twenty units of the study rv-40e lose at most the published arcminute."""
    question = study.load("rv-40e", solve=False)
    errors = tolerances.sample(question.tolerances, 4096, seed=0)
    units, across = jax.tree.map(jnp.asarray, errors), jax.tree.map(lambda x: 0 if np.ndim(x) else None, errors)
    total = jax.vmap(lambda unit: lost_motion.geometric(question.design, unit).total, (across,))(units)
    return float(np.mean(np.abs(np.asarray(total)) <= 1 * arcmin)) > 0.95


COMPUTED: dict[str, Callable[[], PyTree]] = {
    **{f"sizes.rv{size}.stiffness": partial(stiffness, size) for size in TORQUE if size != "320e"},
    "sizes.rv320e.stiffness": lambda: stiffness("320e") < 980.0 < 1.5 * stiffness("320e"),  # two discs or three
    "sizes.rv40e.lost_motion": _lost_motion,
    "sizes.weight": _weights,
}
