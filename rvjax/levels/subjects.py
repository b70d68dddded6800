"""What is measured: for each model its levels, and random cases about a published design.

The outputs are those of `scene`, so that what is measured is what a study computes.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import dynamics
from rvjax.catalogue import CORR, RV_20E, RV_40E, RV_320E
from rvjax.designs import Damping
from rvjax.study import response as scene
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.units import arcmin, rpm, um

SPREAD = 0.05  # of every number of the design
SIZES = (0.3, 1.0, 3.0)

IT6, RADIAL = Tolerance.symmetric(6.5 * um), Tolerance(4 * um, 12 * um)
LINKS = dict(
    crank_eccentricity=IT6,
    crank_phase=Tolerance.symmetric(5 * arcmin),
    disc_bore=IT6,
    carrier_bore=IT6,
    bearing_clearance=RADIAL,
    eccentricity=Tolerance.symmetric(5 * um),
)
FLANK = dict(  # Table 9 of Liu et al. 2022
    bearing_clearance=Tolerance(0.0, 1 * um),
    eccentricity=Tolerance.symmetric(5 * um),
    pin_circle_radius=Tolerance.symmetric(10 * um),
    pin_radius=Tolerance.symmetric(4 * um),
    pin_hole_clearance=Tolerance(0.0, 5 * um),
    pin_position=Tolerance.symmetric(5 * um),
    disc_runout=Tolerance(0.0, 15 * um),
    disc_cumulative_pitch=Tolerance(0.0, 19 * um),
    equidistant_modification=Tolerance.symmetric(1 * um),
    shift_modification=Tolerance.symmetric(3 * um),
    base_tangent_upper=Tolerance(-31 * um, 3 * um),
    base_tangent_lower=Tolerance(-31 * um, 3 * um),
)
ROLLERS = dict(
    cam_radius=Tolerance.symmetric(4 * um),
    eccentricity=Tolerance.symmetric(4 * um),
    roller_radius=Tolerance.symmetric(1 * um),
)


@dataclass(frozen=True)
class Way:
    """One level before it is measured.

    Attributes:
        name: for a person; its precision is added.
        settings: conditions that select it.
        precisions: in which it is measured.
    """

    name: str
    settings: dict[str, Any]
    precisions: tuple[str, ...] = ("float64", "float32")


@dataclass(frozen=True)
class Subject:
    """One model to measure.

    Attributes:
        name: of the model.
        case: what one case is, for a person.
        outputs: units by name.
        design: about which cases are drawn.
        tolerances: drawn at `sizes` times themselves, record or None.
        conditions: of every case, by name.
        torque: smallest and largest, N m; None where it does not matter.
        ways: the levels; the last one, in float64, is the reference.
        evaluate: (settings, design, errors, extra) -> (values of all outputs, status).
        extra: (rng, cases, size) -> what a case has besides design and errors.
        batch: cases in one call.
        calls: of each error size.
        sizes: factors on the errors, ascending.
    """

    name: str
    case: str
    outputs: dict[str, str]
    design: Any
    tolerances: Any
    conditions: dict[str, Any]
    torque: tuple[float, float] | None
    ways: tuple[Way, ...]
    evaluate: Callable[..., Any]
    extra: Callable[..., Any]
    batch: int
    calls: int
    sizes: tuple[float, ...] = field(default=SIZES)

    def draw(self, call: int, size: float, seed: int) -> tuple[Any, Any, Any]:
        """Designs, errors and the rest of a batch of cases, float64, the same at every error size but for the scale.

        Args:
            call: number of the batch.
            size: factor on the errors.
            seed: of the random numbers.
        """
        rng = np.random.default_rng([seed, call])
        design = jax.tree.map(lambda x: x * (1 + rng.uniform(-SPREAD, SPREAD, self.batch)), self.design)
        extra = self.extra(rng, self.batch, size)
        if self.tolerances is None:
            return design, None, extra
        units = jnp.arange(call * self.batch, (call + 1) * self.batch)
        errors = _units(self.tolerances, units, seed)
        return (
            design,
            jax.tree.map(lambda x: jnp.broadcast_to(size * x, (self.batch, *jnp.shape(x)[1:])), errors),
            extra,
        )


def _units(tolerances: Any, units: jax.Array, seed: int) -> Any:
    return jax.jit(jax.vmap(lambda unit: sample(tolerances, unit, seed=seed)))(units)


def _of_scene(outputs: tuple[str, ...], given: Any, torque: str) -> Callable[..., Any]:
    """Outputs of `scene` with the torque of each case."""

    def evaluate(settings: dict[str, Any], design: Any, errors: Any, extra: Any) -> Any:
        conditions = replace(given, **settings, **{torque: extra})
        found = [scene.kind(design).outputs[name].evaluate(design, errors, conditions) for name in outputs]
        return {name: value for name, (value, _) in zip(outputs, found)}, found[0][1]

    return evaluate


def _torques(limits: tuple[float, float]) -> Callable[..., Any]:
    return lambda rng, cases, size: rng.uniform(*limits, cases)


def _turns(closure: str, angles: tuple[int, ...], precisions: tuple[str, ...]) -> list[Way]:
    settings = None if closure == "closed_form" else closure  # None is exact for every kind of cranks
    return [
        Way(f"{closure.replace('_', ' ')}, {n} angles", dict(closure=settings, angles=n), precisions) for n in angles
    ]


def _four_bar(output: str, unit: str, quick: bool) -> Subject:
    loaded = output == "transmission_error"
    torque = (41.2, 412.0)
    both, reference = ("float64", "float32"), ("float64",)
    ways = [] if quick or not loaded else _turns("newton", (64,), reference)
    ways += _turns("first_order", (64,), reference) if loaded else []
    ways += _turns("closed_form", (16, 64) if quick else (8, 16, 32, 64, 256), both)
    # The load changes sides in the joints at once, so that a sampled peak comes near the true one only as 1 / angles:
    # the reference needs many, and float32 is measured against it with fewer only.
    ways += _turns("closed_form", (2048,), reference)
    return Subject(
        name=output,
        case="unit of the RV-40E, a whole crank turn" + (" under load" if loaded else ""),
        outputs={output: unit},
        design=RV_40E,
        tolerances=for_design(RV_40E, **LINKS),
        conditions=dict(cranks="phase_locked"),
        torque=torque if loaded else None,
        ways=tuple(ways),
        evaluate=_of_scene((output,), scene.RVConditions(), "output_torque"),
        extra=_torques(torque),
        batch=4096,
        calls=2 if quick else 7,
        sizes=(*SIZES, 10.0),  # allocation may widen tolerances several times
    )


def _lost_motion(quick: bool) -> Subject:
    design = RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=None))
    profiles = ("first_order", "closed_form", "contact")
    return Subject(
        name="lost_motion",
        case="unit of the RV-20E with K1 = e z_p / r_p",
        outputs={"lost_motion": "rad"},
        design=design,
        tolerances=for_design(design, **FLANK),
        conditions={},
        torque=None,
        ways=tuple(Way(name.replace("_", " "), dict(lost_motion_profile=name)) for name in profiles),
        evaluate=_of_scene(("lost_motion",), scene.RVConditions(), "output_torque"),
        extra=_torques((0.0, 0.0)),
        batch=4096,
        calls=2 if quick else 9,
    )


def _mesh_force(contact: str, quick: bool) -> Subject:
    samples = (1, 8) if quick else (1, 4, 16)
    contacts = ("linear", "hertz") if contact == "hertz" else (contact,)
    ways = [Way(f"{law}, {n} angles a pitch", dict(contact=law, angles=n)) for law in contacts for n in samples[:-1]]
    ways.append(
        Way(f"{contact}, {samples[-1]} angles a pitch", dict(contact=contact, angles=samples[-1]), ("float64",))
    )
    outputs = {"cam_force": "N", "contact_pressure": "Pa"}
    return Subject(
        name="mesh_force" if contact == "hertz" else f"mesh_force, {contact}",
        case="unit of the CORR, a whole work cycle under load",
        outputs=outputs,
        design=CORR,
        tolerances=for_design(CORR, **ROLLERS),
        conditions=dict(contact=contact),
        torque=(11.0, 110.0),
        ways=tuple(ways),
        evaluate=_of_scene(tuple(outputs), scene.CamRollerConditions(), "input_torque"),
        extra=_torques((11.0, 110.0)),
        batch=128,
        calls=1 if quick else 8,
    )


POINTS = 64  # of the compared vibration in a mesh period
SWING, SPEEDS = 0.3, (200 * rpm, 4000 * rpm)


def _vibration(settings: dict[str, Any], design: Any, errors: Any, extra: Any) -> Any:
    """Rotation of the output wheel about its mean over one mesh period."""
    swing, speed, torque = extra
    design = design.replace(mesh_variation=design.mesh_variation.replace(planetary_swing=swing))
    asked = dict(sun_speed=speed, output_torque=torque, outputs=("output.rotation",))
    if settings["method"] == "periodic":
        exact = dynamics.periodic(design, samples=POINTS, **asked)
        curve, status = exact.deflection[:, 0], exact.info.status
    else:
        found = dynamics.response(design, **settings, **asked)
        turn = 2 * np.pi * np.outer(np.arange(POINTS), 1 + np.arange(settings["harmonics"])) / POINTS
        amplitude = found.amplitude[:, 0]
        curve = jnp.cos(turn).astype(speed.dtype) @ amplitude.real - jnp.sin(turn).astype(speed.dtype) @ amplitude.imag
        status = found.info.status
    return {"output_rotation": curve - jnp.mean(curve)}, status


def _dynamics(quick: bool) -> Subject:
    orders = (30,) if quick else (9, 30, 60)
    double, both = ("float64",), ("float64", "float32")
    ways = [
        Way(f"{words}, H = {h}", dict(method=method, harmonics=h), both if h == 30 and not quick else double)
        for words, method in (("first order", "first_order"), ("balance", "harmonic_balance"))
        for h in orders[: 2 if method == "first_order" else 3]
    ]
    ways += [Way("exact periodic", dict(method="periodic"), ("float64",))]

    def extra(rng: Any, cases: int, size: float) -> Any:
        speed = rng.uniform(*SPEEDS, cases)
        return size * SWING * np.ones(cases), speed, rng.uniform(-3136.0, -313.6, cases)

    return Subject(
        name="dynamics",
        case="speed of the RV-320E, vibration of the output over a mesh period; size 1 is a stiffness swing of 0.3",
        outputs={"output_rotation": "rad"},
        design=RV_320E.replace(damping=Damping(modal_ratio=0.02)),
        tolerances=None,
        conditions={},
        torque=(313.6, 3136.0),
        ways=tuple(ways),
        evaluate=_vibration,
        extra=extra,
        batch=8,
        calls=2 if quick else 10,
        sizes=(0.1, 0.3, 1.0),
    )


def subjects(*, quick: bool = False) -> list[Subject]:
    """Everything that is measured.

    Args:
        quick: fewer levels and cases.
    """
    return [
        _four_bar("transmission_error", "rad", quick),
        _four_bar("misfit", "m", quick),
        _lost_motion(quick),
        _mesh_force("hertz", quick),
        *([] if quick else [_mesh_force("palmgren", quick)]),
        _dynamics(quick),
    ]
