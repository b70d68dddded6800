"""What the loaded model refuses, and how it says so."""

import jax
import numpy as np
import pytest
from loaded_cases import NAMED, design_of, errors_of, solve

from rvjax import RVErrors, Status, catalogue, loaded
from rvjax.loaded import case

CASE = NAMED["rv40: all errors, rated, hertz"]
DESIGN = design_of(CASE)
ERRORS = errors_of(CASE, DESIGN)
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


def with_spring(design, name, stiffness):
    """A tree that no constructor judged, as a sampled batch is."""
    springs, design = (jax.tree.map(lambda k: k, part) for part in (design.stiffness, design))
    object.__setattr__(springs, name, stiffness)
    object.__setattr__(design, "stiffness", springs)
    return design


def test_negative_stiffness_of_a_sampled_design_is_a_status():
    """Same program as the reference cases."""
    for path in ("support_bearing", "planet_crank_torsion"):
        found = solve(with_spring(DESIGN, path, -1.0), ERRORS, 1.0, 412.0)
        assert Status(int(found.info.status)) == Status.INVALID_GEOMETRY and np.isnan(found.error)


@pytest.mark.long
def test_a_floating_part_may_lack_its_support_but_none_pushes_it_away():
    """An energy that falls for ever has no minimum; one that neighbours hold needs no spring of its own."""
    case = NAMED["three: carrier and sun floating, palmgren"]
    design, options = design_of(case), dict(contact="palmgren", carrier="floating", sun="floating")
    errors = errors_of(case, design)
    for path in ("output_support", "sun_support", "sun_torsion"):
        found = solve(with_spring(design, path, -1e-3), errors, 1.0, 412.0, **options)
        assert Status(int(found.info.status)) == Status.INVALID_GEOMETRY and np.isnan(found.error)
    free = solve(with_spring(design, "output_support", 0.0), errors, 1.0, 412.0, **options)
    assert Status(int(free.info.status)) == Status.CONVERGED and np.isfinite(free.error)


@pytest.mark.parametrize(("angle", "torque"), [(np.inf, 412.0), (1.0, np.inf)])
def test_conditions_that_are_not_finite_are_a_status(angle, torque):
    found = solve(DESIGN, ERRORS, angle, torque)
    assert Status(int(found.info.status)) == Status.NONFINITE and np.isnan(found.error)


def test_errors_with_a_place_stay_plain_zeros_where_not_given():
    errors = RVErrors.for_design(catalogue.RV_40E)
    assert errors.pin_offset == 0.0 and np.ndim(errors.disc_profile) == 0
    assert np.shape(RVErrors.for_design(catalogue.RV_40E, pin_offset=1e-6).pin_offset) == (40, 2)


def test_every_number_of_a_tree_must_be_finite_and_of_moderate_size():
    """Alone at each place, of either sign; the largest allowed one is the cube root of the largest number."""
    tree, top = [np.array(1.0), np.array([[2.0, -3.0]]), np.array([4.0])], np.finfo(float).max ** (1 / 3)
    for k, leaf in enumerate(tree):
        for place in np.ndindex(leaf.shape):
            for number, fine in ((np.nan, False), (-np.inf, False), (1.01 * top, False), (-0.99 * top, True)):
                changed = leaf.copy()
                changed[place] = number
                assert bool(case._finite([*tree[:k], changed, *tree[k + 1 :]])) == fine, (k, place, number)
