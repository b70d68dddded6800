"""Outputs and bench observations of the four-bar model for studies."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp

from rvjax.catalogue import RV_40E
from rvjax.designs import RVReducer
from rvjax.errors import RVErrors
from rvjax.four_bar.linkage import ALLOWED
from rvjax.four_bar.reducer import figures, harmonics, revolution
from rvjax.outputs import KNOWN_ERROR, Cases, Curve, Description, Observation, Output, Solved, Spectrum, Way, condition
from rvjax.records import Array, PyTree, Scalar
from rvjax.units import arcmin, um

CLOSURES = tuple(dict.fromkeys(closure for allowed in ALLOWED.values() for closure in allowed))
CRANKS = tuple(dict.fromkeys(cranks for cranks, _ in ALLOWED))


@dataclass(frozen=True)
class FourBarConditions:
    """Operating conditions of the second stage of an RV reducer."""

    output_torque: float = condition(0.0, "torque of the discs on the carrier", unit="N m", torque=True)
    angles: int = condition(64, "uniform crank angles over one crank turn", minimum=8, maximum=100_000)
    cranks: str = condition("phase_locked", "how the cranks are held together", choices=CRANKS)
    gear_stiffness_ratio: float | None = condition(None, "of the gears between geared cranks", unit="-")
    closure: str | None = condition(None, "of the crank linkages; the exact one by default", choices=CLOSURES)


def _turn(conditions: FourBarConditions, torque: Scalar) -> dict[str, PyTree]:
    """Arguments of a turn of the cranks."""
    names = ("angles", "cranks", "gear_stiffness_ratio", "closure")
    return dict(output_torque=torque, **{name: getattr(conditions, name) for name in names})


def _spectrum(
    design: RVReducer,
    errors: RVErrors,
    conditions: FourBarConditions,
    torques: Array | None,
    orders: tuple[int, ...],
    alike: bool,
) -> Spectrum:
    """Crank revolutions are equal, so only multiples of the pin count are not zero."""
    pins = design.cycloid.pin_count

    def turn(torque: Scalar) -> Array:
        return harmonics(design, errors, **_turn(conditions, torque))

    waves = turn(0.0)[None] if torques is None else jax.vmap(turn)(torques)
    # The cranks turn against the output: X e^(i h crank) is conj(X) e^(i h pins output). A failed turn stays NaN.
    coefficients = [jnp.conj(waves[:, k // pins]) if k % pins == 0 else 0 * waves[:, 0] for k in orders]
    return jnp.real(waves[:, 0]), jnp.stack(coefficients, axis=1)


CURVE = Observation("curve", _spectrum, samples="angles", period=lambda design: int(design.cycloid.pin_count))


def _transmission_error(design: RVReducer, errors: RVErrors, conditions: FourBarConditions) -> Solved:
    statistics = figures(design, errors, **_turn(conditions, conditions.output_torque), only="error")
    return statistics.peak_to_peak, statistics.info.status


def _misfit(design: RVReducer, errors: RVErrors, conditions: FourBarConditions) -> Solved:
    statistics = figures(design, errors, **_turn(conditions, 0.0), only="misfit")
    return statistics.largest_misfit, statistics.info.status


def _curve(design: RVReducer, errors: RVErrors, conditions: FourBarConditions) -> tuple[Array, Array]:
    loaded = design.cranks.bearing_stiffness is not None  # a study of the misfit alone needs none
    turn = revolution(design, errors, **_turn(conditions, conditions.output_torque if loaded else 0.0))
    return turn.crank_angle, turn.error


IT6 = (-6.5 * um, 6.5 * um)
LINKS = dict(  # errors of the links, as good manufacturing makes them
    crank_eccentricity=IT6,
    crank_phase=(-5 * arcmin, 5 * arcmin),
    disc_bore=IT6,
    carrier_bore=IT6,
    bearing_clearance=(4 * um, 12 * um),
    eccentricity=(-5 * um, 5 * um),
)


def _turns(closure: str, angles: tuple[int, ...], precisions: tuple[str, ...]) -> list[Way]:
    settings = None if closure == "closed_form" else closure  # None is exact for every kind of cranks
    words = closure.replace("_", " ")
    return [Way(f"{words}, {n} angles", dict(closure=settings, angles=n), precisions) for n in angles]


def _cases(quick: bool) -> Sequence[Cases]:
    return [_cases_of("transmission_error", "rad", quick), _cases_of("misfit", "m", quick)]


def _cases_of(output: str, unit: str, quick: bool) -> Cases:
    loaded = output == "transmission_error"
    both, reference = ("float64", "float32"), ("float64",)
    ways = [] if quick or not loaded else _turns("newton", (64,), reference)
    ways += _turns("first_order", (64,), reference) if loaded else []
    ways += _turns("closed_form", (16, 64) if quick else (8, 16, 32, 64, 256), both)
    # The load changes sides in the joints at once, so that a sampled peak comes near the true one only as 1 / angles:
    # the reference needs many, and float32 is measured against it with fewer only.
    ways += _turns("closed_form", (2048,), reference)
    return Cases(
        name=output,
        case="unit of the RV-40E, a whole crank turn" + (" under load" if loaded else ""),
        outputs={output: unit},
        design=RV_40E,
        errors=LINKS,
        conditions=dict(cranks="phase_locked"),
        torque=(41.2, 412.0) if loaded else None,
        ways=tuple(ways),
        batch=4096,
        calls=2 if quick else 7,
        sizes=(0.3, 1.0, 3.0, 10.0),  # allocation may widen tolerances several times
    )


DESCRIPTION = Description(
    name="four_bar",
    design=RVReducer,
    conditions=FourBarConditions,
    outputs={
        "transmission_error": Output(
            "rad",
            "peak to peak over a crank turn under load",
            _transmission_error,
            exact="loaded_transmission_error",
            least=KNOWN_ERROR,
        ),
        "misfit": Output("m", "largest misfit of a disc on the cranks without load (assembly)", _misfit),
    },
    curve=Curve(
        "Transmission error over one crank turn",
        "rad",
        _curve,
        lambda design, _: 1 / design.cycloid.pin_count,
        outputs=("transmission_error",),
    ),
    cases=_cases,
    observations=(CURVE,),
    unknown="pins, flanks, first stage; discs are rigid, only their crank bearings carry them, and their mean counts",
)
