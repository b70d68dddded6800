"""Published values of Yang, Chen, Wang 2018 on the response sensitivity of an RV-320E.

Readings: four cranks, three discs, force angle 30 deg, mesh stiffness variation assumed, no damping, first order,
nine harmonics, 1000 r/min and -3136 N m unless an entry defines others. The eccentricity is varied alone, the
force arm of the discs held.
"""

import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import jax
import numpy as np

from rvjax import dynamics
from rvjax._jax.kernels import in_blocks
from rvjax._jax.sizes import PUBLISHED
from rvjax.catalogue import RV_320E
from rvjax.designs import InvoluteStage, RVReducer
from rvjax.records import PyTree, Scalar
from rvjax.units import deg, mm, rpm

TORQUE = -3136.0
RATED = 1000 * rpm
LUMPED = dynamics.lump(RV_320E)
STAGES = ("planetary", "cycloid")
MEASURED, CALCULATED = (148.95, 387.88, 681.47), (154.56, 396.09, 697.16)  # Table 3, Hz
ERRORS = [100 * (c / m - 1) for c, m in zip(CALCULATED, MEASURED)]
FROM_TEETH = InvoluteStage.from_teeth(15, 69, module=1.5 * mm, pressure_angle=20 * deg)
CROSSED = r"crank\d+\.x", r"disc\d+\.y"  # motions of entry (1, 2) of a crank-disc block
TOO_SMALL = 1e-9  # a relative derivative that is zero to rounding


def _with(name: str, value: Scalar, design: dynamics.Lumped = LUMPED) -> dynamics.Lumped:
    part, _, field = name.rpartition(".")
    return design.replace(**{part: getattr(design, part).replace(**{field: value})} if part else {field: value})


@cache
def _modes() -> dynamics.Modes:
    return dynamics.modes(RV_320E)


def _distinct(kind: str | None = None) -> np.ndarray:
    """Distinct natural frequencies in Hz, of one kind or all."""
    modes = _modes()
    frequency = np.asarray(modes.frequency)[slice(None) if kind is None else modes.kind == kind]
    return frequency[np.append(True, np.diff(frequency) > 1e-6 * frequency[1:])]


SUN = {  # field: harmonic and output whose sensitivity is plotted over its values
    "stiffness.sun_support": (1, "output.x", np.geomspace(0.5e7, 1e9, 200)),
    "stiffness.sun_torsion": (4, "output.rotation", np.geomspace(2e3, 1e6, 200)),
    "inertia.sun_mass": (1, "output.x", np.linspace(0.3, 3.0, 200)),
    "inertia.sun_inertia": (4, "output.rotation", np.linspace(1e-4, 1.2e-3, 200)),
}


@cache
def _slopes() -> dict[str, np.ndarray]:
    """Change of all natural frequencies for a relative change of the eccentricity and of each field of SUN."""
    slopes = jax.jit(jax.jacfwd(lambda d: dynamics.modes(dynamics.with_deviations(LUMPED, d)).frequency))
    return {name: np.asarray(slope) for name, slope in slopes(dict.fromkeys(("eccentricity", *SUN), 0.0)).items()}


def _slope_signs(name: str, kind: str) -> np.ndarray:
    modes = _modes()
    return np.sign(_slopes()[name][(modes.kind == kind) & (np.asarray(modes.frequency) < 2500)])


@cache
def _row(label: str) -> np.ndarray:
    labels = dynamics.assemble(RV_320E).labels
    shape = np.asarray(_modes().shape)
    return shape[labels.index(label)] / np.abs(shape).max(axis=0)


def _still(kind: str, *labels: str) -> bool:
    return max(np.abs(_row(label)[_modes().kind == kind]).max() for label in labels) < 1e-9


def _alike(kind: str, part: str, count: int) -> bool:
    own = _modes().kind == kind
    return all(
        np.allclose(_row(f"{part}{i}.{axis}")[own], _row(f"{part}1.{axis}")[own], atol=1e-9)
        for i in range(2, count + 1)
        for axis in ("x", "y", "rotation")
    )


OUTPUTS = ("output.x", "output.y", "output.rotation", "planet1.y")
MOVED = ("eccentricity", *SUN)
NOMINAL = np.array([LUMPED.eccentricity, *(getattr(getattr(LUMPED, p), f) for p, f in (n.split(".") for n in SUN))])


@jax.jit
@jax.vmap
def _moved(values: jax.Array, along: jax.Array, speed: jax.Array) -> tuple[jax.Array, jax.Array]:
    """B of the planetary stage (9, OUTPUTS) at values of MOVED, and its change along a direction of them."""

    def amplitude(numbers: jax.Array) -> jax.Array:
        design = LUMPED
        for name, value in zip(MOVED, numbers):
            design = _with(name, value, design)
        return dynamics.response(design, sun_speed=speed, output_torque=TORQUE, outputs=OUTPUTS).amplitude

    return jax.jvp(amplitude, (values,), (along,))


def _lanes(name: str, values: PyTree, speed: Scalar = RATED) -> tuple[np.ndarray, np.ndarray]:
    """B (n, 9, OUTPUTS) and dB/dxi over the values of one number and speeds in rad/s, all else nominal."""
    values, speed = (np.asarray(x, float) for x in np.broadcast_arrays(np.atleast_1d(values), speed))
    numbers = np.tile(NOMINAL, (len(values), 1))
    numbers[:, MOVED.index(name)] = values
    along = np.broadcast_to(np.eye(len(MOVED))[MOVED.index(name)], numbers.shape)
    return in_blocks(_moved, PUBLISHED, numbers, along, speed)


@cache
def _nominal(name: str) -> tuple[np.ndarray, np.ndarray]:
    """B (9, OUTPUTS) at rated speed, planetary stage, and its relative change for one of MOVED, 0 where B is."""
    value = NOMINAL[MOVED.index(name)]
    amplitude, slope = (x[0] for x in _lanes(name, value))
    return amplitude, value * slope / np.where(amplitude == 0, 1, amplitude)


@cache
def _amplitude(stage: str) -> np.ndarray:
    """|B| (9, outputs) at rated speed."""
    if stage == "planetary":
        return np.abs(_nominal("eccentricity")[0])
    response = dynamics.response(RV_320E, sun_speed=RATED, output_torque=TORQUE, stage=stage, outputs=OUTPUTS)
    return np.abs(np.asarray(response.amplitude))


def _constant_forcing() -> np.ndarray:
    """Relative change of the harmonics for the eccentricity by Eq. 14, the forces held."""
    slopes = dynamics.log_sensitivities(
        LUMPED, sun_speed=RATED, output_torque=TORQUE, outputs=OUTPUTS, formula="constant_forcing"
    )
    return np.asarray(slopes["eccentricity"])


@cache
def _sun(name: str, speed: float = 1000.0) -> np.ndarray:
    """Sensitivity |d|B|/dxi| of one harmonic over the values of a field of the sun, at a speed in r/min."""
    harmonic, output, values = SUN[name]
    amplitude, slope = (x[:, harmonic - 1, OUTPUTS.index(output)] for x in _lanes(name, values, speed * rpm))
    return np.abs((amplitude.conj() * slope).real / np.abs(amplitude))


def _falls(values: np.ndarray) -> bool:
    return bool(np.all(np.diff(values) < 0))


def _rises(values: np.ndarray) -> bool:
    return bool(np.all(np.diff(values) > 0))


def _raw(name: str, harmonic: int, column: int) -> float:
    """|d|B|/dxi| at rated speed, planetary stage."""
    amplitude, relative = (x[harmonic - 1, column] for x in _nominal(name))
    return abs(relative.real) * abs(amplitude) / NOMINAL[MOVED.index(name)]


SPEEDS = np.arange(500, 2501, 250)
ECCENTRICITIES = np.linspace(1e-3, 4e-3, 121)


@cache
def _norm_slopes() -> np.ndarray:
    """|d(norm of nine harmonics)/de| (speeds, eccentricities, OUTPUTS), force arm held, total derivative."""
    speed, e = np.meshgrid(SPEEDS * rpm, ECCENTRICITIES, indexing="ij")
    amplitude, slope = _lanes("eccentricity", e.ravel(), speed.ravel())
    norm = np.sqrt(np.sum(np.abs(amplitude) ** 2, axis=1))
    derivative = np.abs(np.sum((amplitude.conj() * slope).real, axis=1) / np.where(norm == 0, 1, norm))
    return derivative.reshape(*e.shape, len(OUTPUTS))


def _eccentricity_curves(output: str) -> np.ndarray:
    return _norm_slopes()[..., OUTPUTS.index(output)]


def _falls_then_rises(values: np.ndarray) -> bool:
    turn = int(np.argmin(values))
    return 0 < turn < len(values) - 1 and _falls(values[: turn + 1]) and _rises(values[turn:])


def _always(judge: Callable[[np.ndarray], bool], output: str) -> bool:
    return all(judge(curve) for curve in _eccentricity_curves(output))


def _faster_at_higher_speed(output: str) -> bool:
    """Mean slope of the curve over the eccentricity grows with every step of speed."""
    curves = _eccentricity_curves(output)
    return _rises(curves[:, -1] - curves[:, 0])


def _kinds(cranks: int, discs: int) -> dict[str, int]:
    design = RV_320E.replace(
        cranks=RV_320E.cranks.replace(count=cranks), cycloid=RV_320E.cycloid.replace(disc_count=discs)
    )
    kind = dynamics.modes(design).kind
    return {name: int(np.sum(kind == name)) for name in ("rotational", "translational", "planetary")}


def _suppressed() -> bool:
    """Harmonics that reach each motion."""
    planetary, cycloid = _amplitude("planetary") > 0, _amplitude("cycloid") > 0
    order = np.arange(1, 10)
    return bool(
        np.array_equal(planetary[:, 2], order % 4 == 0)
        and np.array_equal(planetary[:, 0], order % 2 == 1)
        and np.all(planetary[:, 3])  # l = 2, 6 move the planets alone
        and np.array_equal(cycloid[:, 2], order % 3 == 0)
        and np.array_equal(cycloid[:, 0], order % 3 != 0)
    )


def _planetary_with_mesh() -> float:
    """Planetary modes below 5000 Hz (l = 2, mesh frequency 2500 Hz) that move along the line of action."""
    modes = _modes()
    own = (modes.kind == "planetary") & (np.asarray(modes.frequency) / 2 < 2500)
    alpha, rp = RV_320E.involute.pressure_angle, RV_320E.involute.planet_base_radius
    along = -np.sin(alpha) * _row("planet1.x") - np.cos(alpha) * _row("planet1.y") + rp * _row("planet1.rotation")
    return float(np.sum(np.abs(along[own]) > 1e-6))


def _stiffness(design: RVReducer = RV_320E) -> np.ndarray:
    return np.asarray(dynamics.assemble(design).stiffness)


def printed_stiffness() -> np.ndarray:
    """Stiffness of the RV-320E as the appendix prints it, without springs of the output.

    It is the sum over the springs, but for entry (1, 2) of the crank-disc blocks, -sin(psi) in the place of +sin(psi):
    with it a translation of the whole reducer strains the bearings, which no rigid motion can. The tests have the
    appendix block by block.
    """
    labels, matrix = dynamics.assemble(RV_320E).labels, _stiffness().copy()
    cranks, discs = ([k for k, name in enumerate(labels) if re.fullmatch(motion, name)] for motion in CROSSED)
    for rows, columns in ((cranks, discs), (discs, cranks)):
        matrix[np.ix_(rows, columns)] *= -1
    return matrix


def _held_output() -> bool:
    stiffness: Any = RV_320E.stiffness
    held = RV_320E.replace(stiffness=stiffness.replace(output_support=1e8))
    return np.allclose(_stiffness(held)[-3:, -3:], printed_stiffness()[-3:, -3:], rtol=1e-9)


def _zero(name: str, harmonics: tuple[int, ...], column: int) -> bool:
    """No sensitivity of the planetary stage's harmonics to a field."""
    return np.abs(_nominal(name)[1][np.array(harmonics) - 1, column]).max() < TOO_SMALL


COMPUTED: dict[str, Callable[[], Any]] = {
    "rv320e.sec2.dof": lambda: float(len(dynamics.assemble(RV_320E).labels)),
    # Would a planet's block depend on its angle?
    "rv320e.sec2.frames": lambda: not np.allclose(_stiffness()[3:6, 3:6], _stiffness()[6:9, 6:9], rtol=1e-9, atol=1.0),
    "rv320e.table1.base_radii": lambda: [
        FROM_TEETH.sun_base_radius / mm,
        FROM_TEETH.planet_base_radius / mm,
        RV_320E.cycloid.eccentricity * 39 / mm,
    ],
    "rv320e.table1.crank_radius": lambda: RV_320E.cycloid.eccentricity / mm,
    "rv320e.table1.carrier_radius": lambda: FROM_TEETH.centre_distance / mm,
    "rv320e.sec3_2.three_types": lambda: (
        _kinds(4, 3) == {"rotational": 11, "translational": 22, "planetary": 6}
        and np.allclose(np.diff(np.asarray(_modes().frequency)[_modes().kind == "translational"])[::2], 0, atol=1e-6)
    ),
    "rv320e.sec3_2.planetary_condition": lambda: _kinds(3, 3)["planetary"] == 0 and _kinds(4, 3)["planetary"] == 6,
    "rv320e.eq10.rotational_form": lambda: (
        _still("rotational", "sun.x", "sun.y", "output.x", "output.y")
        and _alike("rotational", "planet", 4)
        and _alike("rotational", "crank", 4)
        and _alike("rotational", "disc", 3)
    ),
    "rv320e.eq11.translational_form": lambda: _still("translational", "sun.rotation", "output.rotation"),
    "rv320e.eq12.planetary_form": lambda: _alike("planetary", "planet", 4),
    "rv320e.conclusion.harmonics_suppressed": _suppressed,
    "rv320e.fig3.translation_source": lambda: _amplitude("planetary")[:, 0].max() > _amplitude("cycloid")[:, 0].max(),
    "rv320e.fig3.rotation_source": lambda: all(_amplitude(stage)[:, 2].max() > 1e-9 for stage in STAGES),
    "rv320e.fig4a.translational_peaks": lambda: float(np.sum(_distinct("translational") < 2500)),
    "rv320e.fig4a.odd_harmonics": lambda: np.array_equal(
        _amplitude("planetary")[:5, 0] > 0, [True, False, True, False, True]
    ),
    "rv320e.fig4a.others_absent": lambda: bool(np.all(_amplitude("planetary")[1::2, :2] == 0)),
    "rv320e.fig4b.rotational_only": lambda: (
        np.all(_amplitude("planetary")[:3, 2] == 0) and np.all(_amplitude("cycloid")[:2, 2] == 0)
    ),
    "rv320e.fig4c.planetary_peaks": _planetary_with_mesh,
    "rv320e.eq14.constant_forcing": lambda: np.isclose(_nominal("eccentricity")[1][0, 0], _constant_forcing()[0, 0]),
    "rv320e.sec4_1.rotational_support": lambda: _zero("stiffness.sun_support", (4, 8), 2),
    "rv320e.sec4_2.translational_torsion": lambda: _zero("stiffness.sun_torsion", (1, 3, 5, 7, 9), 0),
    "rv320e.sec4_3.planetary_centre": lambda: all(
        _zero(f"stiffness.sun_{name}", (2,), 3) for name in ("support", "torsion")
    ),
    "rv320e.fig5a.support": lambda: bool(np.all(_slope_signs("stiffness.sun_support", "translational")[:4] > 0)),
    "rv320e.fig5a.two_curves": lambda: float(np.sum(_distinct("translational") < 2500)),
    "rv320e.fig5b.torsion": lambda: bool(np.all(_slope_signs("stiffness.sun_torsion", "rotational") > 0)),
    "rv320e.fig6a.decreasing_1000": lambda: _falls(_sun("stiffness.sun_support")),
    "rv320e.fig6a.decreasing_2000": lambda: _falls(_sun("stiffness.sun_support", 2000.0)),
    "rv320e.fig6b.decreasing": lambda: _falls(_sun("stiffness.sun_torsion")),
    "rv320e.fig7.resonances_fall": lambda: (
        np.all(_slope_signs("inertia.sun_mass", "translational") < 0)
        and np.all(_slope_signs("inertia.sun_inertia", "rotational") < 0)
    ),
    "rv320e.fig7a.mass_over_stiffness": lambda: _raw("inertia.sun_mass", 1, 0) > _raw("stiffness.sun_support", 1, 0),
    "rv320e.fig7b.torsion_over_inertia": lambda: (
        _raw("stiffness.sun_torsion", 4, 2) > _raw("inertia.sun_inertia", 4, 2)
    ),
    "rv320e.fig8a.mass_rises": lambda: all(_rises(_sun("inertia.sun_mass", speed)) for speed in (1000.0, 1250.0)),
    "rv320e.fig8a.speed_influence": lambda: (
        np.diff((_sun("inertia.sun_mass", 1250.0) - _sun("inertia.sun_mass"))[[0, -1]])[0] > 0
    ),
    "rv320e.fig8b.inertia_rises": lambda: _rises(_sun("inertia.sun_inertia")),
    "rv320e.fig9.both_affected": lambda: (
        abs(_nominal("eccentricity")[1][0, 0]) > TOO_SMALL and abs(_nominal("eccentricity")[1][3, 2]) > TOO_SMALL
    ),
    "rv320e.fig9.resonances_rise": lambda: all(
        np.all(_slope_signs("eccentricity", kind) > 0) for kind in ("rotational", "translational")
    ),
    "rv320e.fig10a.translation": lambda: _always(_falls_then_rises, "output.x"),
    "rv320e.fig10b.rotation": lambda: _always(_rises, "output.rotation"),
    "rv320e.fig10b.speed": lambda: _faster_at_higher_speed("output.rotation"),
    "rv320e.abstract.output_sensitive": lambda: bool(abs(_nominal("eccentricity")[1][0, 0].real) > 1),
    "rv320e.abstract.translation": lambda: _always(_falls_then_rises, "output.x"),
    "rv320e.abstract.rotation": lambda: _always(_rises, "output.rotation"),
    "rv320e.sec5.stiffness_low": lambda: _sun("stiffness.sun_support")[0] > _sun("stiffness.sun_support")[-1],
    "rv320e.sec5.inertia_large": lambda: _sun("inertia.sun_mass")[-1] > _sun("inertia.sun_mass")[0],
    "rv320e.conclusion.eccentricity_both": lambda: (
        _always(_falls_then_rises, "output.x") and _always(_rises, "output.rotation")
    ),
    "rv320e.conclusion.higher_speed": lambda: (
        _faster_at_higher_speed("output.rotation") and _faster_at_higher_speed("output.x")
    ),
    "rv320e.table3.row1_model": lambda: _distinct()[0],
    "rv320e.table3.row2_model": lambda: _distinct()[1],
    "rv320e.table3.row3_model": lambda: _distinct()[2],
    **{f"rv320e.table3.row{row}_error": partial(float, error) for row, error in enumerate(ERRORS, 1)},
    "rv320e.table3.within_four_percent": lambda: max(ERRORS) < 4,
    "rv320e.appendix.crank_block": lambda: np.diag(_stiffness())[15:18],
    "rv320e.appendix.disc_block": lambda: np.diag(_stiffness())[27:30],
    "rv320e.appendix.output_block": lambda: np.diag(_stiffness())[36:39],
    "rv320e.appendix.output_support": _held_output,
    # Entry (1, 2) of a crank-disc block with sin(psi) != 0: crank 2, disc 1.
    "rv320e.appendix.crank_disc_sign": lambda: np.isclose(_stiffness()[18, 28], printed_stiffness()[18, 28]),
}
