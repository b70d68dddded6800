"""Least clearance of flanks and pins: does a unit jam? Against a linear programme, closed forms and the equilibrium."""

import jax
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, plain, solve
from scipy import optimize

from rvjax import RVErrors, loaded, study
from rvjax.catalogue import CORR, RV_40E
from rvjax.loaded import unchecked
from rvjax.loaded.geometry import Lines, largest_gap
from rvjax.status import Status
from rvjax.tolerances import allocate
from rvjax.units import um

K1 = 0.8125
MACHINE = design_of(NAMED["rv40: all errors, rated, hertz"])
NOTHING = errors_of({"errors": {}}, MACHINE)


def placed(rng, size=8 * um):
    """Errors of every pin, tooth and disc."""
    return NOTHING.replace(
        pin_offset=size * rng.standard_normal((40, 2)), pin_radii=size * rng.standard_normal(40),
        disc_pitch=size * rng.standard_normal((2, 39)), disc_centre=size * rng.standard_normal((2, 2)),
        disc_profile=size * rng.standard_normal((2, 5, 2)), ring_centre=size * rng.standard_normal(2),
        equidistant_modification=5 * size, shift_modification=-3 * size,
    )  # fmt: skip


def clearance(design, errors):
    """At seven angles, by one program for all cases."""
    return loaded.clearance(*plain((design, errors)), samples=7)


def test_the_highest_point_of_lines_is_that_of_a_linear_programme():
    rng = np.random.default_rng(3)
    gaps = rng.normal(0, 5 * um, (40, 80))
    levers = np.concatenate([rng.uniform(-0.05, 0.05, (40, 79)), np.zeros((40, 1))], axis=1)
    found, left = jax.jit(jax.vmap(largest_gap))(Lines(gaps[:, None], levers[:, None]))
    for gap, lever, value in zip(gaps, levers, found):
        rows = np.stack([np.ones(80), lever], axis=1)  # t + lever beta <= gap, most t
        due = optimize.linprog([-1, 0], A_ub=rows, b_ub=gap / um, bounds=[(None, None)] * 2)
        assert value / um == pytest.approx(-due.fun, abs=1e-9)
    assert np.max(np.abs(left)) < 1e-12 * um


def modified(equidistant, shift):
    cycloid = MACHINE.cycloid.replace(equidistant_modification=equidistant, shift_modification=shift)
    return MACHINE.replace(cycloid=cycloid)


def test_closed_forms():
    """An equidistant modification is the clearance everywhere; of a shift the flank at cos psi = K1 keeps the least."""
    assert clearance(modified(0.0, 0.0), NOTHING).least == pytest.approx(0.0, abs=1e-12 * um)
    assert clearance(modified(12 * um, 0.0), NOTHING).least == pytest.approx(12 * um)
    errors = NOTHING.replace(pin_radius=7.5 * um, pin_hole_clearance=6 * um)
    assert clearance(modified(12 * um, 0.0), errors).least == pytest.approx(7.5 * um)
    shifted = clearance(modified(0.0, -30 * um), NOTHING).least
    assert shifted == pytest.approx(30 * um * np.sqrt(1 - K1**2), rel=1e-4)
    assert clearance(modified(0.0, 30 * um), NOTHING).least < -30 * um * np.sqrt(1 - K1**2)


def test_a_reducer_without_torque_is_free_where_the_clearance_is_positive():
    """The equilibrium at no torque: no pin is pressed, or several are, on both sides."""
    rng, seen = np.random.default_rng(5), set()
    for number in range(6):
        errors = placed(rng).replace(equidistant_modification=(18 + 6 * number) * um)
        clear = clearance(modified(-2 * um, 0.0), errors).at[0]
        found = solve(modified(-2 * um, 0.0), errors, 0.0, 0.0)
        assert (found.info.status == Status.UNLOADED) == (clear > 0), clear
        assert clear > 0 or np.sum(np.asarray(found.pins) > 0) >= 2
        seen.add(bool(clear > 0))
    assert seen == {True, False}


def test_slopes_are_those_of_the_plain_value():
    design, errors = plain((modified(-2 * um, 0.0), placed(np.random.default_rng(7))))

    def difference(**moves):
        """Of the plain value, 1e-3 um to either side."""
        moved = [{n: getattr(errors, n) + s * 1e-3 * um * by for n, by in moves.items()} for s in (1, -1)]
        ends = [float(clearance(design, errors.replace(**changes)).least) for changes in moved]
        return (ends[0] - ends[1]) / (2e-3 * um)

    slopes = jax.jit(jax.grad(lambda errors: loaded.clearance(design, errors, samples=7).least))(errors)
    for name in ("equidistant_modification", "shift_modification"):
        assert float(getattr(slopes, name)) == pytest.approx(difference(**{name: 1.0}), rel=1e-6), name
    along = np.random.default_rng(8).standard_normal((40, 2))
    due = difference(pin_offset=along)
    assert float(np.sum(np.asarray(slopes.pin_offset) * along)) == pytest.approx(due, rel=1e-6)


def test_a_case_that_cannot_be_has_a_status():
    pins = {3e-3: Status.CONVERGED, 8e-3: Status.UNDERCUT, -1.0: Status.INVALID_GEOMETRY, np.nan: Status.NONFINITE}
    for radius, status in pins.items():
        found = clearance(MACHINE.replace(cycloid=unchecked(MACHINE.cycloid, pin_radius=radius)), NOTHING)
        assert found.info.status == status and np.isnan(found.least) == (status != Status.CONVERGED)
    with pytest.raises(ValueError, match="takes a design of kind RVReducer"):
        loaded.clearance(CORR, RVErrors())
    with pytest.raises(ValueError, match="samples = 0"):
        loaded.clearance(RV_40E, RVErrors(), samples=0)


ROBUST = """
[design]
base = "rv-40e"
cycloid.disc_teeth = 11
cycloid.pin_count = 12
cycloid.eccentricity = "4 mm"
cycloid.profile_modification = ["0 um", "0 um", "0 um", "0 um"]
[variable."cycloid.equidistant_modification"]
lower = "-20 um"
upper = "30 um"
[variable."cycloid.shift_modification"]
lower = "-20 um"
upper = "20 um"
[variable."cycloid.profile_modification[1]"]
lower = "-1 um"
upper = "1 um"
[objective]
lost_motion = {price = 10.0, per = "1 arcmin"}
[conditions]
samples = 7
[tolerances.pin_circle_radius]
half_width = "7.5 um"
[tolerances.equidistant_modification]
half_width = "7.5 um"
[run]
samples = 128
certificate_samples = 2000
[requirement.flank_clearance]
lower = "0 um"
target = 0.995
"""


def robust():
    """The nominal design, the optimum of `allocate`, and the design of it; 12 pins, since 40 take ten times as long."""
    made = study.parse_study(ROBUST, name="x", solve=False)
    found = allocate(
        made.design_response(), made.tolerances, made.requirements | made.nominal, costs=made.costs,
        variables=made.variables, objective={name: price(1.0) for name, price in made.objective.items()},
        samples=made.samples, certificate_samples=made.certificate_samples,
    )  # fmt: skip
    return made.design, found, made.design_with(found.values)


@jax.jit
def least_of(design, circle, flank):
    errors = RVErrors(pin_circle_radius=circle, equidistant_modification=flank)
    return loaded.clearance(design, errors, samples=7).least


def jammed(design):
    """Share of 1000 other units within +-7.5 um that jam."""
    circle, flank = 2.5 * um * np.random.default_rng(0).standard_normal((2, 1000))
    return np.mean(jax.vmap(least_of, (None, 0, 0))(design, circle, flank) < 0)


@pytest.mark.long  # closed forms, and units that are free or not under no torque, run by default
def test_the_optimum_of_the_documentation_does_not_jam():
    """Modifications of docs/design.md under normal errors within +-7.5 um at 3 sigma; unmodified every second jams."""
    amplitudes = np.array([0.58, 0.16, 0.69, -0.49]) * um
    whole = modified(-10.0 * um, -39.2 * um)
    whole = whole.replace(cycloid=whole.cycloid.replace(profile_modification=amplitudes))
    bare = modified(0.0, 0.0)
    bare = bare.replace(cycloid=bare.cycloid.replace(profile_modification=np.zeros(4)))  # the same program
    assert jammed(bare) > 0.4 and jammed(whole) <= 0.005


@pytest.mark.long
def test_an_optimum_that_knows_the_errors_does_not_jam():
    """Least backlash; the nominal reducer alone needs none, and every second unit of it jams."""
    nominal, found, design = robust()
    assert found.status == "OPTIMAL"
    assert jammed(nominal) > 0.4 and jammed(design) <= 0.01
    ideal, own = (loaded.clearance(each, RVErrors(), samples=7).least for each in (nominal, design))
    assert ideal == pytest.approx(0.0, abs=1e-12 * um) and own > 5 * um
