"""The measured RV reducer of ratio 81: its numbers and curve, a fit, spectra by class of errors, its encoder.

Only teeth, cranks and ratio of the measured reducer are known (22, 44, 39, 40; three cranks; a comment in the source
calls it an RV-160N). Everything else of `MACHINE` is assumed: lengths are those of the RV-320E, times the cube root of
the ratio of the rated torques (1/2), rounded; springs are its published ones times the same, torsional ones the cube.
"""

from collections.abc import Callable, Sequence
from functools import cache, lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy import optimize

from rvjax import loaded
from rvjax._jax.kernels import in_blocks
from rvjax.base.fields import axis_sizes
from rvjax.designs import Contact, CrankStage, CycloidStage, InvoluteStage, RVReducer, Stiffness
from rvjax.errors import RVErrors, described
from rvjax.records import Scalar
from rvjax.units import arcmin, arcsec, deg, mm, um

RATED = 1600.0  # assumed: torque of an RV-160, N m
MACHINE = RVReducer(
    involute=InvoluteStage.from_teeth(22, 44, module=1.5 * mm),  # teeth: source; module assumed, that of the RV-320E
    cycloid=CycloidStage(
        disc_teeth=39,  # source
        pin_count=40,  # source
        disc_count=2,  # assumed: usual layout
        eccentricity=1.75 * mm,  # assumed: 2.2 mm * 0.794
        pin_circle_radius=90.0 * mm,  # assumed: 114 mm * 0.794
        pin_radius=4.0 * mm,  # assumed: 5 mm * 0.794
    ),
    cranks=CrankStage(count=3, circle_radius=49.5 * mm),  # count: source; circle assumed: 1.5 mm (22 + 44) / 2
    stiffness=Stiffness(  # assumed: RV-320E, Table 2, lengths * 0.794; a fit scales all of them
        sun_support=3.3e7,
        sun_torsion=5.8e3,
        planet_crank_bending=1.85e8,
        planet_crank_torsion=3.5e4,
        support_bearing=7.8e8,
        turning_arm_bearing=7.7e8,
        sun_planet_mesh=2.1e8,
        disc_pin_mesh=6.6e8,
    ),
    contact=Contact(young_modulus=2.06e11, poisson_ratio=0.3, face_width=18 * mm),  # assumed: steel, a fifth of rp
)

# Half of backward less forward transmission error at 100 r/min and 25 C.
TORQUE = np.array([0.0, 100, 200, 300, 400, 500, 700, 900, 1000, 1200, 1300, 1400])
MEASURED = np.array([0.182, 0.599, 0.879, 1.132, 1.368, 1.513, 1.990, 2.436, 2.688, 3.143, 3.371, 3.560]) * arcmin
FITTED = np.arange(len(TORQUE)) % 2 == 0

DRAWN = ["pin_offset", "pin_radii", "ring_centre", "disc_pitch", "disc_centre", "disc_profile"]
DRAWN += ["crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "sun_runout", "planet_runout"]
SHAPES = {name: axis_sizes(described(RVErrors, "shape")[name], MACHINE.counts) for name in DRAWN}
NONE = RVErrors(**{name: np.zeros(shape) for name, shape in SHAPES.items()})
"""No error, in the shapes that all units of this module have: one program solves them."""


def pattern(seed: int = 0) -> RVErrors:
    """Scatter of pins, teeth and crank journals of an assumed unit, standard deviation 1 um."""
    draw = np.random.default_rng(seed).normal
    drawn = ("pin_offset", "disc_pitch", "crank_eccentricity")
    return NONE.replace(**{name: um * draw(size=SHAPES[name]) for name in drawn})


# Forward, 200 to 1400 N m at 100 r/min and 25 C, of the quadratic fit to 675 curves that the source publishes.
GROWTH_PHASE = 25.1 * deg
# Median amplitudes over all torques, orders of the output turn.
AMPLITUDE = {2: 0.98, 3: 2.84, 39: 3.81, 40: 3.02, 78: 3.38, 80: 0.74, 81: 1.08, 120: 0.61, 159: 1.03}

ANGLES = 8
"""Input angles over an output revolution for its mean."""
Numbers = Sequence[Scalar] | np.ndarray
FREE = ("factor", "gears", "clearance", "play", "scatter")
"""Parameters of a fit: factor on all springs, factor on the gears, radial clearance of the arm bearings, clearance
of the pins, standard deviation of `pattern`; lengths in um."""


def _error(log: jax.Array, errors: RVErrors, angle: jax.Array, torque: jax.Array) -> jax.Array:
    """Transmission error for the logarithms of `FREE`."""
    factor, gears, clearance, play, scatter = jnp.exp(log)
    springs = jax.tree.map(lambda k: k * factor, MACHINE.stiffness)
    assert springs is not None
    springs = springs.replace(sun_planet_mesh=springs.sun_planet_mesh * gears)
    errors = jax.tree.map(lambda x: x * scatter, errors)
    errors = errors.replace(bearing_clearance=clearance * um, equidistant_modification=play * um)
    design = MACHINE.replace(stiffness=springs)
    return loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque).error


_with_slopes = jax.jit(jax.vmap(jax.value_and_grad(_error), (None, None, 0, 0)))


LANES = 2 * len(TORQUE) * ANGLES  # of a call


def _solved(values: Numbers, errors: RVErrors, angle: np.ndarray, torque: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transmission error at angles and torques (n,), and its slopes to the logarithms of `FREE`."""
    return in_blocks(
        partial(_with_slopes, jnp.log(jnp.asarray(np.asarray(values, float))), errors), LANES, angle, torque
    )


def half_difference(values: Numbers, errors: RVErrors, torque: Numbers = TORQUE) -> tuple[np.ndarray, np.ndarray]:
    """Half of backward less forward transmission error, (n,) rad, and its slopes to the logarithms, (n, 5).

    Args:
        values: of `FREE`, all > 0.
        errors: `pattern`.
        torque: N m (n,); none counts as the probe torque, a thousandth of the rated one.
    """
    turn = 2 * np.pi * MACHINE.ratio
    load = np.maximum(np.asarray(torque, float), 1e-3 * RATED)
    angle, signed = np.meshgrid(turn * np.arange(ANGLES) / ANGLES, np.concatenate([-load, load]))
    error, slope = _solved(values, errors, angle.ravel(), signed.ravel())

    def half(x: np.ndarray) -> np.ndarray:
        backward, forward = np.asarray(x).reshape(2, len(load), ANGLES, -1).mean(axis=2)
        return (backward - forward) / 2

    return half(error)[:, 0], half(slope)


class Fit(NamedTuple):
    """A fit to every second torque."""

    values: np.ndarray  # of `FREE`
    sd: np.ndarray  # relative, of the free ones, from the scatter of the residuals
    correlation: np.ndarray  # of the free ones
    angle: np.ndarray  # at TORQUE, rad

    @property
    def fitted(self) -> float:
        """Root mean square of the residuals at the torques fitted to, rad."""
        return _rms((self.angle - MEASURED)[FITTED])

    @property
    def predicted(self) -> float:
        """Root mean square of the residuals at the other torques, rad."""
        return _rms((self.angle - MEASURED)[~FITTED])


def _rms(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x**2)))


START = dict(factor=0.5, gears=1.0, clearance=3.0, play=1e-3, scatter=2.0)


def fit(
    free: Sequence[str] = ("factor", "clearance", "scatter"),
    seed: int = 0,
    steps: int = 20,
    measured: np.ndarray = MEASURED,
    **fixed: float,
) -> Fit:
    """Fit the logarithms by least squares, so that every value stays positive; held against half of the torques.

    Args:
        free: names of `FREE` that move.
        seed: of `pattern`.
        steps: at most.
        measured: windup at each torque, rad; the fit uses `FITTED`.
        **fixed: values of others, or where the free ones start; by default those of `START`.
    """
    errors, moves = pattern(seed), np.array([name in free for name in FREE])
    log = np.log([(START | fixed)[name] for name in FREE])

    @lru_cache(1)
    def at(*moved: float) -> tuple[np.ndarray, np.ndarray]:
        log[moves] = moved
        return half_difference(np.exp(log), errors)

    solution = optimize.least_squares(
        lambda moved: (at(*moved)[0] - measured)[FITTED] / arcmin,
        log[moves],
        jac=lambda moved: at(*moved)[1][FITTED][:, moves] / arcmin,
        xtol=1e-5,
        max_nfev=steps + 1,
    )
    angle, slope = at(*solution.x)
    rows = slope[FITTED][:, moves]
    freedom = FITTED.sum() - moves.sum()
    covariance = np.sum((angle - measured)[FITTED] ** 2) / freedom * np.linalg.inv(rows.T @ rows)
    sd = np.sqrt(np.diag(covariance))
    return Fit(np.exp(log), sd, covariance / np.outer(sd, sd), angle)


SAMPLES = 512
"""Angles of an output turn: orders up to 255."""
NO_PLAY = 1e-9  # um; a logarithm needs a number


def classes(size: float = 3 * um, seed: int = 1, clearance: float = 0.0) -> dict[str, RVErrors]:
    """One class of errors at a time, each number of standard deviation `size`, and all of them.

    Args:
        size: m; a phase gets the angle that moves a journal by it.
        seed: of the draw.
        clearance: radial, of the arm bearings, m; in every unit.
    """
    draw, none = np.random.default_rng(seed).normal, NONE.replace(bearing_clearance=clearance)
    scale = {"crank_phase": size / MACHINE.cycloid.eccentricity}
    parts = {name: scale.get(name, size) * draw(size=shape) for name, shape in SHAPES.items()}
    alone = {name: none.replace(**{name: value}) for name, value in parts.items()}
    return {"none": none} | alone | {"all": none.replace(**parts)}


def spectra(units: dict[str, RVErrors], torque: Numbers, factor: float) -> dict[str, np.ndarray]:
    """Amplitudes (torques, SAMPLES / 2) of the orders of an output turn, rad.

    Args:
        units: {name: errors}, of `classes`.
        torque: N m (n,).
        factor: on every spring.
    """
    turn = 2 * np.pi * MACHINE.ratio * np.arange(SAMPLES) / SAMPLES
    load, angle = np.meshgrid(np.asarray(torque, float), turn, indexing="ij")
    amplitudes = {}
    for name, errors in units.items():
        values = dict(factor=factor, gears=1.0, clearance=errors.bearing_clearance / um, play=NO_PLAY, scatter=1.0)
        error, _ = _solved([values[free] for free in FREE], errors, angle.ravel(), load.ravel())
        amplitudes[name] = 2 / SAMPLES * np.abs(np.fft.rfft(error.reshape(load.shape)))[..., : SAMPLES // 2]
    return amplitudes


@cache
def _fit() -> Fit:
    return fit()


DRAG = 10.2
"""Fitted rise of the friction torque at the output from 100 to 1000 r/min of the input, N m."""


def faster(torque: object) -> np.ndarray:
    """Half of backward less forward transmission error of the fit at 1000 r/min, (n,) rad, at bench torques (n,), N m.

    Load and drag both oppose the motion, so `DRAG` adds to the torque of the bench.
    """
    return half_difference(_fit().values, pattern(), np.asarray(torque, float) + DRAG)[0]


@cache
def _spectra() -> dict[str, np.ndarray]:
    return spectra({"disc_centre": classes(clearance=3 * um)["disc_centre"]}, [100.0, 1400.0], 0.5)


def _stiffness() -> float:
    """Secant of the fit between 900 and 1400 N m, N m/arcmin."""
    angle = np.interp([900.0, 1400.0], TORQUE, _fit().angle) / arcmin
    return float(500.0 / (angle[1] - angle[0]))


def _unmoved() -> bool:
    low, high = _spectra()["disc_centre"][:, 40]
    return bool(abs(high / low - 1) < 0.05)


assert MACHINE.contact is not None
READ = MACHINE.replace(contact=MACHINE.contact.replace(pin_support=1e8))  # assumed; 5e7 to 2e8 fit the phases
ENCODER = loaded.Reading(
    radius=75 * mm,  # assumed
    ring_gain=5.87e-10,  # fitted to the growth of order 78; m/N
    tilt_gain=1 / 1.01e7,  # moment rigidity of the main bearings of a reducer of this size, recalled
    height=50 * mm,  # assumed
    disc_position=(-11 * mm, 11 * mm),  # assumed
    dent=5.4e-9,  # fitted to the growth of order 3; rad/(N m)
)
READ_ANGLES = 240
"""Of an output turn: orders up to 119; higher ones fall on orders of the same harmonic of the housing."""


@jax.jit
def _read(torque: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Reading and transmission error over an output turn without errors of parts, (angles,) rad."""

    def at(angle: jax.Array) -> tuple[jax.Array, jax.Array]:
        solution = loaded.equilibrium(READ, NONE, input_angle=angle, output_torque=torque)
        return loaded.reading(solution, READ, ENCODER, input_angle=angle, output_torque=torque), solution.error

    return jax.vmap(at)(jnp.asarray(2 * np.pi * READ.ratio * np.arange(READ_ANGLES) / READ_ANGLES))


@cache
def read_orders(*torques: float) -> np.ndarray:
    """Orders of [reading, transmission error] of an output turn: complex a in Re(a exp(i n th)), rad.

    Args:
        torques: of the bench; < 0 for the backward direction, N m (n,).

    Returns:
        Shape (n, 2, orders).
    """
    curves = np.stack([jax.device_get(_read(torque)) for torque in torques])
    waves: np.ndarray = 2 / READ_ANGLES * np.fft.rfft(curves)
    return waves


def _growth() -> list[float]:
    """Orders 78, 39 and 3 of the reading, arcsec per kN m."""
    low, high = np.abs(read_orders(500.0, 1000.0))[:, 0] / arcsec
    return list(2 * (high - low)[[78, 39, 3]])


def growth_phase(low: float = 500.0, high: float = 1000.0) -> float:
    """Phase of the growth of order 78 less twice that of order 39, rad in (-pi, pi]; negative torques: backward.

    Head at D, pins and index turn the phase of an order by m D and by its order times an angle: 78 - 2 x 39 = 0 and
    2 - 2 x 1 = 0, so that this combination depends on none of them.

    Args:
        low: torque of the bench, N m.
        high: another one.
    """
    first, second = read_orders(low, high)[:, 0]
    growth = second - first
    return float(np.angle(growth[78] * np.conj(growth[39]) ** 2))


def _same_phase() -> bool:
    """True if the phases of the growth combine as measured, within 15 deg: one of twelve uniform phases does."""
    return bool(abs(np.angle(np.exp(1j * (growth_phase() - GROWTH_PHASE)))) < 15 * deg)


def _grows(order: int) -> bool:
    """In proportion to the torque within 2 %, in the reading only."""
    (low, _), (high, error) = np.abs(read_orders(500.0, 1000.0))[..., order]
    return bool(abs(high / low - 2) < 0.04 and error < 1e-6 * high)


COMPUTED: dict[str, Callable[[], Any]] = {
    "rv160.windup.fitted": lambda: (_fit().angle / arcmin)[FITTED],
    "rv160.windup.predicted": lambda: (_fit().angle / arcmin)[~FITTED],
    "rv160.windup.stiffness": _stiffness,
    "rv160.windup.no_load_at_1000_rpm": lambda: float(faster([0.0])[0] / arcmin),
    "rv160.orders.40_stays": _unmoved,
    "rv160.orders.78_grows": lambda: _grows(78),
    "rv160.orders.39_grows": lambda: _grows(39),
    "rv160.orders.growth": _growth,
    "rv160.orders.growth_phase": _same_phase,
}
