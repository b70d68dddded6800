"""Responses whose failures and figures are known, for `benchmarks.coverage`."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy import integrate, stats

from rvjax import catalogue, mesh_force
from rvjax.published.corr import CALIBRATED_TORQUE
from rvjax.tolerances import Outcome, Tolerance, for_design
from rvjax.units import um

SF = stats.norm.sf


@dataclasses.dataclass(frozen=True)
class Rare:
    """A response, its fields, its upper limit and the exact probability of more."""

    response: Callable[[Any], Any]
    tolerances: Any
    limit: float
    exact: float
    samples: int = 4000


def _fields(n):
    return {"v": Tolerance.symmetric(3.0, shape=(n,))}  # standard normal


def _any_of(n, beta=4.5):
    return -math.expm1(n * stats.norm.logcdf(beta))


def _parabola(bend):
    return integrate.quad(lambda x: stats.norm.pdf(x) * SF(4 + bend / 2 * x * x), -10, 10)[0]


def _four_branches(e):
    """Waarts 2000: a series system of two parabolas and two planes."""
    s, d = (e["v"][0] + e["v"][1]) / math.sqrt(2), e["v"][0] - e["v"][1]
    return jnp.maximum(jnp.abs(s) - 0.1 * d**2 - 4, jnp.abs(d) - 8 / math.sqrt(2))


def _exact_branches():
    """With d = x sqrt 2, x and s independent standard normal numbers."""
    beyond = lambda x: 1.0 if abs(x) > 4 else 2 * SF(4 + 0.2 * x * x)  # noqa: E731
    return integrate.quad(lambda x: stats.norm.pdf(x) * beyond(x), -12, 12, points=(-4, 0, 4), limit=200)[0]


CORNER = 1.5631  # sixteen corners of a cube of five: 1.145e-5


def _parity(e):
    """Largest in the sixteen corners of a cube in five numbers whose signs have a positive product."""
    v = e["v"]
    return jnp.prod(jnp.sign(v)) * jnp.min(jnp.abs(v))


def _pin(e):
    found = mesh_force.solve(catalogue.CORR, e, input_torque=CALIBRATED_TORQUE, output_angle=0.3)
    return Outcome(jnp.max(found.gear), found.info.status)


PIN = "peak pin force"
PIN_TOLERANCES = for_design(
    catalogue.CORR,
    cam_radius=Tolerance.symmetric(6 * um),
    eccentricity=Tolerance.symmetric(6 * um),
    roller_radius=Tolerance.symmetric(3 * um),
)
PIN_LIMIT = 15_000.0  # N

RARE = {
    "linear": Rare(lambda e: jnp.sum(e["v"]) / math.sqrt(3), _fields(3), 4.0, SF(4.0)),
    **{
        f"maximum of {n}": Rare(lambda e: jnp.max(e["v"]), _fields(n), 4.5, _any_of(n)) for n in (2, 8, 26, 33, 64, 200)
    },
    "largest of 50, either sign": Rare(lambda e: jnp.max(jnp.abs(e["v"])), _fields(50), 4.5, _any_of(100)),
    "ring among 30": Rare(lambda e: jnp.hypot(e["v"][0], e["v"][7]), _fields(30), 5.0, math.exp(-12.5)),
    "four branches": Rare(_four_branches, _fields(2), 0.0, _exact_branches()),
    "parabola, bent away": Rare(lambda e: e["v"][0] - 0.075 * e["v"][1] ** 2, _fields(2), 4.0, _parabola(0.15)),
    "parabola, bent towards": Rare(lambda e: e["v"][0] + 0.075 * e["v"][1] ** 2, _fields(2), 4.0, _parabola(-0.15)),
    "plateau in ten": Rare(lambda e: jnp.where(jnp.max(e["v"]) > 4.5, 1.0, 0.0), _fields(10), 0.5, _any_of(10)),
    "quantised sum of ten": Rare(
        lambda e: jnp.floor(4 * jnp.sum(e["v"]) / math.sqrt(10)) / 4, _fields(10), 3.9, SF(4.0)
    ),
    "parity of five signs": Rare(_parity, _fields(5), CORNER, 16 * SF(CORNER) ** 5),
    "parity of five signs, plateau": Rare(
        lambda e: jnp.where(_parity(e) > CORNER, 1.0, 0.0), _fields(5), 0.5, 16 * SF(CORNER) ** 5
    ),
    "saturated by tanh": Rare(
        lambda e: jnp.tanh(2 * jnp.sum(e["v"]) / math.sqrt(10)), _fields(10), math.tanh(2 * 3.5), SF(3.5)
    ),
    "hidden corner": Rare(
        lambda e: jnp.where(jnp.min(e["v"][:2]) > 3.2, 2.0, jnp.tanh(e["v"][2])), _fields(10), 1.5, SF(3.2) ** 2
    ),
    "unlike parts, 64": Rare(
        lambda e: jnp.max(jnp.asarray(np.linspace(0.7, 1.3, 64)) * e["v"]),
        _fields(64),
        5.0,
        -math.expm1(stats.norm.logcdf(5 / np.linspace(0.7, 1.3, 64)).sum()),
    ),
    PIN: Rare(_pin, PIN_TOLERANCES, PIN_LIMIT, math.nan, 1000),
}
