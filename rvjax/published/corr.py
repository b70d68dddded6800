"""Published values of Wei et al. 2021 (Chin. J. Mech. Eng. 34:84) on the mesh forces of the oscillatory roller stage.

The crank torque is not published; it is set so that the mean cam force of Table 1 comes out, hence absolute
forces are weak evidence and changes are the stronger one. Linear contacts: the exact ones differ by 2e-5.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache, partial
from types import MappingProxyType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import mesh_force
from rvjax.catalogue import CORR
from rvjax.errors import CamRollerErrors
from rvjax.published import figures
from rvjax.units import mm, um

CALIBRATED_TORQUE = 109.56418376586802
"""Crank torque in N m at which the mean cam force of the CORR is the published 1735 N; itself not published."""

PUBLISHED_STUDIES: Mapping[str, tuple[str, float, float]] = MappingProxyType(
    {
        "11": ("eccentricity", 2.5 * mm, 4.0 * mm),
        "12": ("roller_radius", 7.0 * mm, 20.0 * mm),
        "13": ("cam_radius", 125.0 * mm, 170.0 * mm),
        "14": ("errors.cam_radius", -20.0 * um, 20.0 * um),
        "15": ("errors.eccentricity", -10.0 * um, 50.0 * um),
        "16": ("errors.roller_radius", -20.0 * um, 20.0 * um),
    }
)
"""Figure of Wei et al. 2021: what it varies, from where to where; beyond 10.05 mm Fig. 12 has no tooth flank."""

TORQUE = round(CALIBRATED_TORQUE, 2)  # [method.corr_cycle] of the ledger, as the next one
SAMPLES = 40
Z, N, LINK = CORR.gear_teeth, CORR.gear_teeth + 1, 0.143
E, R = float(CORR.eccentricity), float(CORR.roller_radius)

# What is varied and the values at which a figure shows forces; the first two are the ends of its range.
VALUES: dict[str, tuple[float, ...]] = {name: (first, last) for name, first, last in PUBLISHED_STUDIES.values()}
VALUES["roller_radius"] = (7.0 * mm, 10.0 * mm)  # no flank beyond 10.05 mm
VALUES["errors.cam_radius"] += (0.0, 2 * um)
VALUES["errors.eccentricity"] += (0.0, 10 * um, 20 * um)
VALUES["errors.roller_radius"] += (0.0,)
UNITS = [(parameter, value) for parameter, values in VALUES.items() for value in values]


@cache
def _cycles() -> mesh_force.CycleStatistics:
    """Statistics of all units of the figures, in one program."""
    units = []
    for parameter, value in UNITS:
        name = parameter.removeprefix("errors.")
        of_errors = name != parameter
        design = CORR if of_errors else CORR.replace(**{name: value})
        units.append((design, CamRollerErrors(**{name: value} if of_errors else {})))
    stacked = jax.tree.map(lambda *leaves: jnp.asarray(leaves), *units)
    run = partial(mesh_force.cycle_statistics, input_torque=TORQUE, contact="linear", samples=SAMPLES)
    return jax.device_get(jax.jit(jax.vmap(lambda unit: run(*unit)))(stacked))


def _at(name: str, parameter: str, value: float) -> float:
    return float(getattr(_cycles(), name)[UNITS.index((parameter, value))])


def _ends(parameter: str, name: str) -> list[float]:
    return [_at(name, parameter, value) for value in VALUES[parameter][:2]]


def _at_end(end: int, parameter: str, *names: str) -> float | list[float]:
    values = [_at(name, parameter, VALUES[parameter][end]) for name in names]
    return values if len(names) > 1 else values[0]


def _change(parameter: str, name: str) -> float:
    """From the first end of the range to the second, %."""
    first, second = _ends(parameter, name)
    return 100 * (second / first - 1)


def _growth(name: str, parameter: str, value: float) -> float:
    """Statistic with an error over that without it."""
    return _at(name, parameter, value) / _at(name, parameter, 0.0)


def _changes_little(parameter: str, share: float, *names: str) -> bool:
    """No value of the range moves a statistic by more than this share of that without error."""
    return all(abs(_growth(name, parameter, value) - 1) <= share for name in names for value in VALUES[parameter])


@cache
def _cycle() -> tuple[np.ndarray, mesh_force.MeshForces]:
    """Angles of the work cycle, and the forces at Table 1."""
    angles = mesh_force.cycle_angles(Z, samples=SAMPLES)
    return angles, _forces(angles)


@jax.jit
@jax.vmap
def _solved(angle: jax.Array) -> mesh_force.MeshForces:
    return mesh_force.solve(CORR, CamRollerErrors(), input_torque=TORQUE, contact="linear", output_angle=angle)


def _forces(angles: np.ndarray) -> mesh_force.MeshForces:
    """At Table 1, of as many angles as a work cycle has: one program."""
    return jax.device_get(_solved(angles))


def _leads() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """psi, gamma, beta and s of every roller at every angle of the cycle, written as in the source."""
    angles, _ = _cycle()
    psi = Z * angles[:, None] - 2 * np.pi * np.arange(N) / N
    gamma = np.arcsin(E / LINK * np.sin(psi))
    return psi, gamma, np.arctan(Z * np.tan(gamma)), E * np.cos(psi) + LINK * np.cos(gamma)


@cache
def _profile() -> tuple[np.ndarray, mesh_force.ToothProfile]:
    """Two teeth of the gear."""
    angles = np.linspace(0, 4 * np.pi / Z, 81)
    return angles, jax.device_get(jax.jit(jax.vmap(lambda angle: mesh_force.tooth_profile(CORR, angle)))(angles))


def _flank_repeats() -> bool:
    """The same flank on every tooth, swept at the ratio of the tooth counts: the ratio of the speeds is constant."""
    _, profile = _profile()
    radius = np.hypot(*profile.flank.T)
    return bool(np.allclose(radius[:41], radius[40:], rtol=1e-12))


def _profile_normal() -> bool:
    angles, profile = _profile()
    gamma = np.arcsin(E / LINK * np.sin(Z * angles))
    return bool(np.allclose(profile.normal_angle, angles + np.arctan(Z * np.tan(gamma)), atol=1e-12))


def _centre_circle() -> bool:
    """Distance of the roller centres from the cam centre: Rj + r, not Rj."""
    angles, profile = _profile()
    cam = E * np.stack([np.sin(N * angles), np.cos(N * angles)], axis=1)
    return bool(np.allclose(np.linalg.norm(profile.centre - cam, axis=1), CORR.cam_radius))


def _statics() -> bool:
    _, forces = _cycle()
    _, gamma, beta, _ = _leads()
    size = 1e-9 * forces.gear.max()
    along = np.allclose(forces.cam * np.cos(gamma), forces.gear * np.cos(beta), atol=size)
    return along and np.allclose(forces.cam * np.sin(gamma) + forces.gear * np.sin(beta), forces.cage, atol=size)


def _gear_projection() -> bool:
    _, forces = _cycle()
    _, gamma, beta, _ = _leads()
    loaded = forces.cam > 0
    return bool(
        np.allclose((forces.gear / np.where(loaded, forces.cam, 1) * np.cos(beta))[loaded], np.cos(gamma)[loaded])
    )


def _moment_arm() -> bool:
    psi, gamma, _, s = _leads()
    return bool(np.allclose(E * np.sin(psi + gamma), s * np.sin(gamma), atol=1e-15))


def _fixed_index_set() -> bool:
    """Return the rollers loaded at an angle are those loaded half a tooth later."""
    angles = 0.001 + np.pi / Z * (np.arange(SAMPLES) % 2)
    loaded = _forces(angles).cam > 0
    return bool((loaded == loaded[0]).all())


def _printed_cage_projection() -> bool:
    """Eq. 14 with tan(theta_i) leaves every roller a positive compliance."""
    theta = 2 * np.pi * np.arange(N) / N
    gamma = np.arcsin(E / LINK * np.sin(-theta))
    cage, gear = np.abs(N * np.sin(gamma)), np.cos(gamma) / np.cos(np.arctan(Z * np.tan(gamma)))
    return bool((1 + np.tan(theta) * np.cos(gamma) * cage + gear**2 > 0).all())


def _printed_windup() -> bool:
    psi, gamma, _, _ = _leads()
    return bool(np.allclose(np.sin(gamma), np.sin(psi + gamma)))


def _errors_fluctuate() -> bool:
    """20 um of each error move the peak of the cam force by more than a tenth."""
    errors = ("errors.cam_radius", "errors.eccentricity", "errors.roller_radius")
    return not any(abs(_growth("cam_peak", error, 20 * um) - 1) <= 0.1 for error in errors)


def _strongest() -> bool:
    roller, cam, throw = (
        _at("cam_mean", f"errors.{name}", 20 * um) for name in ("roller_radius", "cam_radius", "eccentricity")
    )
    return roller > cam > throw


def _centre_circle_change() -> float:
    """Return the mean cage force is 2 T / (Rj + r) by statics; roller radius 7 to 20 mm, %."""
    return 100 * ((135 + 7) / (135 + 20) - 1)


def _largest_roller() -> float:
    """Largest roller without undercut, mm; a roller of 20 mm is larger."""
    return float(mesh_force.largest_roller_radius(CORR)) / mm


_eccentricity, _cam = partial(_change, "eccentricity"), partial(_change, "cam_radius")

COMPUTED: dict[str, Callable[[], Any]] = {
    "corr.abstract.roller_radius_change": _centre_circle_change,
    "corr.abstract.errors_fluctuate": _errors_fluctuate,
    "corr.intro.half_of_teeth": lambda: float(np.median((_cycle()[1].cam > 0).sum(1))),
    "corr.sec2.at_most_half_loaded": lambda: bool(((_cycle()[1].cam > 0).sum(1) <= N // 2).all()),
    "corr.sec2.constant_ratio": _flank_repeats,
    "corr.table1.ratio": lambda: float(N),
    "corr.eq3.profile_normal": _profile_normal,
    "corr.eq4.statics": _statics,
    "corr.eq6_eq7.centre_circle": _centre_circle,
    "corr.eq8.moment_arm": _moment_arm,
    "corr.eq8.index_set": _fixed_index_set,
    # Eq. 11 with the roller length in the radical of the half-width vanishes without force?
    "corr.eq11.approach": lambda: abs(R - math.sqrt(R**2 - (float(CORR.roller_length) / 2) ** 2)) < 1e-9,
    "corr.eq14.cage_projection": _printed_cage_projection,
    "corr.eq15.gear_projection": _gear_projection,
    "corr.eq16.windup": _printed_windup,
    "corr.eq18.error_sign": lambda: _growth("cam_mean", "errors.cam_radius", 2 * um) < 1,
    "corr.fig11.eccentricity_strong": lambda: abs(_eccentricity("cam_mean")) > 10,
    "corr.fig11.cage_mean_unchanged": lambda: abs(_eccentricity("cage_mean")) < 1,
    "corr.fig11.cage_p2p_unchanged": lambda: abs(_eccentricity("cage_peak_to_peak")) < 1,
    "corr.fig12.little_effect": lambda: all(
        abs(_change("roller_radius", name)) < 2 for name in ("cam_mean", "gear_mean")
    ),
    "corr.fig12.range": _largest_roller,
    "corr.fig12.cage_mean_change": _centre_circle_change,
    "corr.fig13.smaller_than_eccentricity": lambda: abs(_cam("cam_mean")) < abs(_eccentricity("cam_mean")),
    "corr.fig15.huge_effect": lambda: _growth("cam_peak", "errors.eccentricity", 50 * um) > 2,
    "corr.fig15.cam_gear_mean_small": partial(_changes_little, "errors.eccentricity", 0.5, "cam_mean", "gear_mean"),
    "corr.fig15.peak_rise": lambda: _growth("cam_peak", "errors.eccentricity", -10 * um) <= 1,
    "corr.fig16.strongest": _strongest,
    "corr.fig16.cage_p2p_small": partial(_changes_little, "errors.roller_radius", 0.5, "cage_peak_to_peak"),
    "corr.conclusion.eccentricity_cage_little": lambda: abs(_eccentricity("cage_mean")) < 1,
    "corr.conclusion.radii_small_on_cam_gear": lambda: abs(_cam("cam_mean")) < 2 and abs(_cam("cage_mean")) > 20,
    "corr.conclusion.roller_cage_mean": _centre_circle_change,
    "corr.conclusion.smoother_less_force": lambda: _cam("cam_peak") < 0,
}

# `compute` of a figure: one of these, what varies, and of which statistic.
_FORMS: dict[str, Callable[..., Any]] = {
    "change": _change,
    "ends": _ends,
    "first": partial(_at_end, 0),
    "last": partial(_at_end, 1),
}
COMPUTED |= {
    figure["id"]: partial(_FORMS[figure["compute"][0]], *figure["compute"][1:])
    for figure in figures("corr")
    if "compute" in figure
}
COMPUTED |= {figure["id"]: _largest_roller for figure in figures("corr") if "presupposes" in figure}
