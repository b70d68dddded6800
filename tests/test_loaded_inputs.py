"""What the loaded model refuses, and how it says so."""

import jax
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of

from rvjax import RVErrors, Status, catalogue, loaded

CASE = NAMED["rv40: all errors, rated, hertz"]
DESIGN = design_of(CASE)
AT = dict(input_angle=1.0, output_torque=412.0)


@pytest.mark.parametrize("name", ["stiffness", "contact"])
def test_missing_parts_are_named(name):
    with pytest.raises(ValueError, match=f"RVReducer.{name} = None"):
        loaded.equilibrium(DESIGN.replace(**{name: None}), RVErrors(), **AT)


@pytest.mark.parametrize("method", [dict(contact="hard"), dict(carrier="loose"), dict(sun="loose")])
def test_unknown_methods_are_named(method):
    (name,) = method
    for call in (loaded.equilibrium, loaded.torsion, loaded.revolution):
        with pytest.raises(ValueError, match=f"{name} = '.*must be one of"):
            call(DESIGN, RVErrors(), **method, **_conditions(call))


def _conditions(call):
    return {
        loaded.equilibrium: AT,
        loaded.torsion: dict(input_angle=0.0, rated_torque=1.0),
        loaded.revolution: dict(output_torque=1.0),
    }[call]


def test_other_tooth_differences_are_refused():
    cycloid = DESIGN.cycloid.replace(pin_count=41)
    with pytest.raises(ValueError, match=r"pin_count = 41: must be disc_teeth \+ 1 = 40"):
        loaded.equilibrium(DESIGN.replace(cycloid=cycloid), RVErrors(), **AT)


@pytest.mark.parametrize(
    ("field", "shape", "expected"),
    [
        ("pin_offset", (39, 2), r"\(pins, 2\) = \(40, 2\)"),
        ("pin_radii", (41,), r"\(pins,\) = \(40,\)"),
        ("disc_pitch", (2, 40), r"\(discs, teeth\) = \(2, 39\)"),
        ("disc_profile", (3, 5, 2), r"\(discs, 5, 2\) = \(2, 5, 2\)"),
        ("planet_runout", (3, 2), r"\(cranks, 2\) = \(2, 2\)"),
    ],
)
def test_wrong_shapes_name_the_one_expected(field, shape, expected):
    with pytest.raises(ValueError, match=rf"RVErrors.{field}: shape .*expected {expected}"):
        loaded.equilibrium(DESIGN, RVErrors(**{field: np.zeros(shape)}), **AT)
    with pytest.raises(ValueError, match=rf"RVErrors.{field}: shape .*expected {expected}"):
        RVErrors.for_design(DESIGN, **{field: np.zeros(shape)})


def test_samples_must_be_positive():
    with pytest.raises(ValueError, match="samples = 0"):
        loaded.revolution(DESIGN, RVErrors(), output_torque=1.0, samples=0)


def with_spring(name, stiffness):
    """A tree that no constructor judged, as a sampled batch is."""
    springs, design = (jax.tree.map(lambda k: k, part) for part in (DESIGN.stiffness, DESIGN))
    object.__setattr__(springs, name, stiffness)
    object.__setattr__(design, "stiffness", springs)
    return design


def test_negative_stiffness_of_a_sampled_design_is_a_status():
    """Same program as the reference cases."""
    for path in ("support_bearing", "planet_crank_torsion"):
        found = loaded.equilibrium(with_spring(path, -1.0), errors_of(CASE, DESIGN), **AT)
        assert Status(int(found.info.status)) == Status.INVALID_GEOMETRY and np.isnan(found.error)


def test_a_floating_part_may_lack_its_support_but_none_pushes_it_away():
    """An energy that falls for ever has no minimum; one that neighbours hold needs no spring of its own."""
    afloat = AT | {"carrier": "floating", "sun": "floating"}
    for path in ("output_support", "sun_support", "sun_torsion"):
        found = loaded.equilibrium(with_spring(path, -1e-3), errors_of(CASE, DESIGN), **afloat)
        assert Status(int(found.info.status)) == Status.INVALID_GEOMETRY and np.isnan(found.error)
    free = loaded.equilibrium(with_spring("output_support", 0.0), errors_of(CASE, DESIGN), **afloat)
    assert Status(int(free.info.status)) == Status.CONVERGED and np.isfinite(free.error)


@pytest.mark.parametrize("condition", ["input_angle", "output_torque"])
def test_conditions_that_are_not_finite_are_a_status(condition):
    found = loaded.equilibrium(DESIGN, errors_of(CASE, DESIGN), **{**AT, condition: np.inf})
    assert Status(int(found.info.status)) == Status.NONFINITE and np.isnan(found.error)


def test_numbers_that_leave_the_arithmetic_are_a_status_and_spoil_no_gradient():
    """Squares of 1e300 m overflow, those of 1e-300 m vanish; angles beyond 2^50 rad have no direction."""
    errors = errors_of(CASE, DESIGN)
    plain = {
        "input_angle": AT["input_angle"],
        "circle_radius": DESIGN.cranks.circle_radius,
        "face_width": DESIGN.contact.face_width,
        "pin_radius": DESIGN.cycloid.pin_radius,
    }

    def error(numbers, size):
        parts = {name: jax.tree.map(lambda k: k, getattr(DESIGN, name)) for name in ("cranks", "contact", "cycloid")}
        for part in parts.values():
            for path, x in numbers.items():
                if hasattr(part, path):
                    object.__setattr__(part, path, x)
        design = jax.tree.map(lambda k: k, DESIGN)
        for name, part in parts.items():
            object.__setattr__(design, name, part)
        at = AT | {"input_angle": numbers["input_angle"]}
        found = loaded.equilibrium(design, errors.replace(eccentricity=size), **at)
        return jax.numpy.where(jax.numpy.isfinite(found.error), found.error, 0), found.info.status

    solve = jax.jit(jax.value_and_grad(error, argnums=(0, 1), has_aux=True))
    plain = {path: float(x) for path, x in plain.items()}
    assert Status(int(solve(plain, 0.0)[0][1])) == Status.CONVERGED
    for path in plain:
        for x in (1e30,) if path == "input_angle" else (1e300, 1e-300):
            (value, status), slope = solve(plain | {path: x}, 0.0)
            assert Status(int(status)) == Status.NONFINITE and value == 0, (path, x)
            assert np.all(np.isfinite(jax.tree.leaves(slope))), (path, x)


def test_a_flank_whose_curvature_has_no_slope_spoils_no_gradient():
    """K1 within 1e-9 of 1: the sharpest point is nearly a cusp, which judges undercut and is no part of the answer."""
    errors, largest = errors_of(CASE, DESIGN), DESIGN.cycloid.pin_circle_radius / DESIGN.cycloid.pin_count
    missing = (1 - 1e-9) * largest - DESIGN.cycloid.eccentricity - errors.eccentricity

    @jax.jit
    @jax.grad
    def slope(added):
        found = loaded.equilibrium(DESIGN, errors.replace(eccentricity=errors.eccentricity + added), **AT)
        return jax.numpy.where(jax.numpy.isfinite(found.error), found.error, 0)

    assert np.isfinite(slope(missing))


def test_errors_with_a_place_stay_plain_zeros_where_not_given():
    errors = RVErrors.for_design(catalogue.RV_40E)
    assert errors.pin_offset == 0.0 and np.ndim(errors.disc_profile) == 0
    assert np.shape(RVErrors.for_design(catalogue.RV_40E, pin_offset=1e-6).pin_offset) == (40, 2)
