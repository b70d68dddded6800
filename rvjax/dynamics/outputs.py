"""Outputs and bench observations of the dynamic model for studies."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.elementary import root
from rvjax.catalogue import RV_320E
from rvjax.designs import Damping, RVReducer
from rvjax.dynamics.assembly import Lumped, loaded, lump
from rvjax.dynamics.error_response import DynamicError, transmission_error
from rvjax.dynamics.error_speeds import SpeedRange, speed_range
from rvjax.dynamics.excitation import STAGES, mesh_frequency
from rvjax.dynamics.modes import modes
from rvjax.dynamics.periodic import periodic
from rvjax.dynamics.response import METHODS, response
from rvjax.dynamics.symmetry import KINDS
from rvjax.errors import RVErrors
from rvjax.outputs import Cases, Description, Observation, Output, Solved, Way, condition
from rvjax.records import Array, PyTree, Scalar
from rvjax.units import rpm


def _frequencies(design: RVReducer, errors: RVErrors, conditions: object) -> tuple[Array, Array]:
    """Frequencies (n,) Hz, ascending, and mass-normalised shapes (n, n), one in each column."""
    solution = modes(errors.stiffened(design))
    return solution.frequency, solution.shape


FREQUENCIES = Observation("frequencies", _frequencies, ("inertia", "stiffness"))


ROTATION = "output.rotation"
Evaluate = Callable[[RVReducer, RVErrors, "DynamicConditions"], Solved]


@dataclass(frozen=True)
class DynamicConditions:
    """Speeds and load of a vibrating RV reducer; a speed is None only where no output needs it."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)
    sun_speed: float = condition(None, "speed of the vibration", unit="rad/s")
    slowest_sun_speed: float = condition(None, "lower end of the range of speeds", unit="rad/s")
    fastest_sun_speed: float = condition(None, "upper end of the range of speeds", unit="rad/s")
    speeds: int = condition(
        40, "of the range of excitation, in addition to the resonances within it", minimum=2, maximum=10_000
    )
    load_inertia: float | None = condition(
        None, "of what the output drives; it decides where the joint resonates", unit="kg m2", minimum=0.0
    )
    pin_harmonics: int = condition(8, "of errors of single pins", minimum=0, maximum=1000)
    stage: str = condition("planetary", "whose mesh stiffness varies", choices=STAGES)
    harmonics: int = condition(9, "of the mesh frequency", minimum=1, maximum=1000)
    method: str = condition("first_order", "of the vibration", choices=METHODS)


def _vibration(design: RVReducer, errors: RVErrors, conditions: DynamicConditions) -> Solved:
    """Root mean square of the output's rotation about its mean; the load on the output is the carrier's reversed."""
    solution = response(
        _with_load(lump(errors.stiffened(design)), conditions),
        sun_speed=conditions.sun_speed,
        output_torque=-conditions.output_torque,
        stage=conditions.stage,
        harmonics=conditions.harmonics,
        method=conditions.method,
        outputs=(ROTATION,),
    )
    square = jnp.sum(jnp.square(solution.amplitude.real) + jnp.square(solution.amplitude.imag)) / 2
    return root(square), solution.info.status


def _resonance_margin(design: RVReducer, errors: RVErrors, conditions: DynamicConditions) -> Solved:
    """Least distance of the mesh frequency from the torsional modes, over the mode; < 0: a mode is within the range."""
    lumped = _with_load(lump(errors.stiffened(design)), conditions)
    solution = modes(lumped)
    speeds = sorted((conditions.slowest_sun_speed, conditions.fastest_sun_speed))
    low, high = sorted(abs(mesh_frequency(lumped, speed, conditions.stage)) / (2 * np.pi) for speed in speeds)
    low = 0.0 if speeds[0] < 0 < speeds[1] else low  # both senses of rotation: through rest
    torsional = (solution.kind_index == KINDS.index("rotational")) | (solution.kind_index == KINDS.index("coupled"))
    elastic = torsional & (solution.frequency > 0)
    frequency = jnp.where(elastic, solution.frequency, 1)
    distance = jnp.maximum(low / frequency - 1, 1 - high / frequency)
    margin = jnp.min(jnp.where(elastic, distance, jnp.inf))
    return jnp.where(jnp.isfinite(solution.frequency[0]), margin, jnp.nan), solution.info.status


def _with_load(lumped: Lumped, conditions: DynamicConditions) -> Lumped:
    return lumped if conditions.load_inertia is None else loaded(lumped, conditions.load_inertia)


def _at_worst(at_speed: Callable[[DynamicError], Scalar], over_range: Callable[[SpeedRange], Scalar]) -> Evaluate:
    """Vibration that errors excite at `sun_speed`, or at the worst of the range of speeds where one is given."""

    def evaluate(design: RVReducer, errors: RVErrors, conditions: DynamicConditions) -> Solved:
        options: dict[str, PyTree] = dict(load_inertia=conditions.load_inertia, pin_harmonics=conditions.pin_harmonics)
        ends: dict[str, PyTree] = dict(
            slowest_sun_speed=conditions.slowest_sun_speed, fastest_sun_speed=conditions.fastest_sun_speed
        )
        missing = [name for name, end in ends.items() if end is None]
        stiffened = errors.stiffened(design)
        if not missing:
            worst = speed_range(stiffened, errors, **ends, speeds=conditions.speeds, **options)
            return over_range(worst), worst.info.status
        if len(missing) == 1 or conditions.sun_speed is None:
            raise ValueError(f"conditions.{missing[0]} is missing: errors excite at a range of speeds or at sun_speed")
        solution = transmission_error(stiffened, errors, sun_speed=conditions.sun_speed, **options)
        return at_speed(solution), solution.info.status

    return evaluate


def _acceleration(error: DynamicError) -> jax.Array:
    """Root mean square over time, Eq. 15."""
    line = error.amplitude[:, 0]
    square = jnp.square(line.real) + jnp.square(line.imag)
    square = jnp.sum(square * (2 * jnp.pi * error.frequency) ** 4) / 2
    return root(square)


def _standing(design: RVReducer, errors: RVErrors, conditions: DynamicConditions) -> Solved:
    error = transmission_error(errors.stiffened(design), errors, sun_speed=0.0, pin_harmonics=conditions.pin_harmonics)
    return error.peak_to_peak[0], error.info.status


POINTS = 64  # of the compared vibration in a mesh period
SWING, SPEEDS = 0.3, (200 * rpm, 4000 * rpm)


def _over_a_period(
    settings: Mapping[str, PyTree], design: RVReducer, errors: RVErrors | None, extra: tuple[Array, Array, Array]
) -> tuple[dict[str, Array], Array]:
    """Rotation of the output wheel about its mean over one mesh period."""
    swing, speed, torque = extra
    assert design.mesh_variation is not None
    design = design.replace(mesh_variation=design.mesh_variation.replace(planetary_swing=swing))
    load: dict[str, PyTree] = dict(sun_speed=speed, output_torque=torque, outputs=(ROTATION,))
    if settings["method"] == "periodic":
        exact = periodic(design, samples=POINTS, **load)
        curve, status = exact.deflection[:, 0], exact.info.status
    else:
        solution = response(design, **settings, **load)
        turn = 2 * np.pi * np.outer(np.arange(POINTS), 1 + np.arange(settings["harmonics"])) / POINTS
        amplitude = solution.amplitude[:, 0]
        curve = jnp.cos(turn).astype(speed.dtype) @ amplitude.real - jnp.sin(turn).astype(speed.dtype) @ amplitude.imag
        status = solution.info.status
    return {"output_rotation": curve - jnp.mean(curve)}, status


def _cases(quick: bool) -> Sequence[Cases]:
    orders = (30,) if quick else (9, 30, 60)
    double, both = ("float64",), ("float64", "float32")
    ways = [
        Way(f"{words}, H = {h}", dict(method=method, harmonics=h), both if h == 30 and not quick else double)
        for words, method in (("first order", "first_order"), ("balance", "harmonic_balance"))
        for h in orders[: 2 if method == "first_order" else 3]
    ]

    def extra(rng: np.random.Generator, cases: int, size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return size * SWING * np.ones(cases), rng.uniform(*SPEEDS, cases), rng.uniform(-3136.0, -313.6, cases)

    return [
        Cases(
            name="dynamics",
            case="speed of the RV-320E, vibration of the output over a mesh period; size 1 is a stiffness swing of 0.3",
            outputs={"output_rotation": "rad"},
            design=RV_320E.replace(damping=Damping(modal_ratio=0.02)),
            errors=None,
            conditions={},
            torque=(313.6, 3136.0),
            ways=(*ways, Way("exact periodic", dict(method="periodic"), double)),
            batch=8,
            calls=2 if quick else 10,
            sizes=(0.1, 0.3, 1.0),
            evaluate=_over_a_period,
            extra=extra,
        )
    ]


DESCRIPTION = Description(
    name="dynamics",
    design=RVReducer,
    conditions=DynamicConditions,
    outputs={
        "vibration": Output(
            "rad", "root mean square rotation of the output about its mean", _vibration, ("sun_speed",), "arcsec"
        ),
        "resonance_margin": Output(
            "-",
            "mesh frequency to the nearest torsional mode over the mode, < 0: a resonance within the speeds",
            _resonance_margin,
            ("slowest_sun_speed", "fastest_sun_speed"),
        ),
        "static_transmission_error": Output("rad", "peak to peak at standstill, errors as excitation", _standing),
        "dynamic_transmission_error": Output(
            "rad",
            "peak to peak of the output, largest over the speeds, errors as excitation",
            _at_worst(lambda found: found.peak_to_peak[0], lambda found: found.peak_to_peak),
            ("load_inertia",),
        ),
        "dynamic_vibration": Output(
            "rad/s2",
            "root mean square acceleration of the output, largest over the speeds, errors as excitation",
            _at_worst(_acceleration, lambda found: found.acceleration),
            ("load_inertia",),
        ),
    },
    cases=_cases,
    observations=(FREQUENCIES,),
    unknown="clearance, loss of contact, friction; products of errors and varying mesh stiffness",
)
