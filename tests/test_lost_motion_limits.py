"""Lost motion outside the ordinary: statuses by lane, extremes, what is refused, single precision.

Oracles: statuses by their definition; limits in closed form; float64 for float32.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from lost_motion_cases import TRUE_K1, cycloid, solve

from rvjax import RVErrors, Status
from rvjax.catalogue import RV_20E, RV_20E_ERRORS
from rvjax.lost_motion import geometric
from rvjax.lost_motion.outputs import PROFILES
from rvjax.units import arcmin, deg, mm, um

NAN, INVALID = Status.NONFINITE, Status.INVALID_GEOMETRY
BAD = [
    ("shortening", 0.0, INVALID),
    ("shortening", 1.0, INVALID),
    ("shortening", -0.5, INVALID),
    ("eccentricity", 0.0, INVALID),
    ("eccentricity", -1e-3, INVALID),
    ("pin_circle_radius", 0.0, INVALID),
    ("sun_radius", 0.0, INVALID),
    ("pressure_angle", 91 * deg, INVALID),
    ("tilt", 90 * deg, INVALID),
    ("tilt", -2.0, INVALID),
    ("centre_shift", -27.5 * mm, INVALID),
    ("tilt", jnp.inf, NAN),
    ("centre_shift", jnp.inf, NAN),
    ("pin_circle_radius", jnp.inf, NAN),
    ("pin_radius_error", jnp.nan, NAN),
    ("pin_radius_error", -jnp.inf, NAN),
    ("shortening", jnp.nan, NAN),
    ("tilt", 0.0, Status.CONVERGED),
]


def case_of(name, value):
    """A function of all the numbers that may go wrong."""
    numbers = dict(
        shortening=0.72, eccentricity=0.9 * mm, pin_circle_radius=52 * mm, sun_radius=13.5 * mm,
        pressure_angle=20 * deg, tilt=1e-3, centre_shift=0.0, pin_radius_error=-0.014 * mm,
    )  # fmt: skip
    return numbers | {name: value}


def run_case(numbers, profile):
    stage = {name: numbers[name] for name in ("shortening", "eccentricity", "pin_circle_radius")}
    first = {name: numbers[name] for name in ("sun_radius", "pressure_angle")}
    design = cycloid(RV_20E.replace(involute=RV_20E.involute.replace(**first)), **stage)
    errors = RV_20E_ERRORS.replace(pin_radius=numbers["pin_radius_error"])
    options = {name: numbers[name] for name in ("tilt", "centre_shift")}
    return geometric(design, errors, profile=profile, **options)


@pytest.mark.parametrize(
    "profile", [p if p == "first_order" else pytest.param(p, marks=pytest.mark.long) for p in PROFILES]
)
def test_bad_lanes_have_a_status_and_leave_their_neighbours_alone(profile):
    cases = [case for case in BAD if profile != "contact" or case[0] != "shortening"]
    batch = {key: jnp.array([case_of(name, value)[key] for name, value, _ in cases]) for key in case_of("tilt", 0.0)}

    def mean(shared, lanes):  # of the good lanes, as statistics would take it
        found = jax.vmap(lambda lane: run_case({key: lane[key] * shared[key] for key in lane}, profile))(lanes)
        return jnp.sum(jnp.where(jnp.isnan(found.total), 0, found.total)), found

    # The bad numbers multiply the shared ones, so only the stand-ins keep their gradient finite.
    gradient = jax.jit(jax.grad(mean, argnums=(0, 1), has_aux=True))
    shared = dict.fromkeys(batch, 1.0)
    (by_shared, by_lane), result = gradient(shared, batch)
    for status, (name, value, expected) in zip(result.info.status, cases):
        assert Status(int(status)) == expected, (name, value)
    good = np.array([case[2] == Status.CONVERGED for case in cases])
    for leaf in jax.tree.leaves((result.total, result.play, result.terms)):
        np.testing.assert_array_equal(np.isfinite(leaf), good)
    repeated = {key: jnp.full_like(value, value[good.argmax()]) for key, value in batch.items()}
    (expected, _), _ = gradient(shared, repeated)
    assert good.sum() == 1
    for key in batch:
        assert np.all(np.isfinite(by_lane[key])) and np.all(np.asarray(by_lane[key])[~good] == 0), key
        if np.all(np.isfinite(batch[key])):  # else the product with the shared number itself is to blame
            np.testing.assert_allclose(by_shared[key], expected[key] / len(good), rtol=1e-12, atol=1e-18)


def test_printed_reading_states():
    run = jax.jit(jax.vmap(lambda f: geometric(RV_20E, RV_20E_ERRORS, reading="as_printed", normal_force=f)))
    result = run(jnp.array([1.6, 0.5075, 0.0, -1.0, jnp.nan]))
    expected = [Status.CONVERGED, Status.PRESSURE_ANGLE, INVALID, INVALID, NAN]
    assert [Status(int(s)) for s in result.info.status] == expected
    np.testing.assert_array_equal(np.isfinite(result.total), [True, True, False, False, False])
    np.testing.assert_array_equal(result.valid, [True, False, False, False, False])


def test_extremes():
    flat = solve(cycloid(RV_20E, shortening=1 - 1e-12), RV_20E_ERRORS)
    assert flat.valid and -5e3 < flat.total / arcmin < -4e3
    large = cycloid(RV_20E, disc_teeth=10**6, pin_count=10**6 + 1, shortening=0.72)
    only = solve(large, RV_20E_ERRORS)
    assert only.valid and np.isfinite(only.total)
    assert solve(large, RV_20E_ERRORS, dtype=np.float32).valid
    near = [
        solve(RV_20E, RV_20E_ERRORS, centre_shift=-27.5 * mm + gap).terms.bearing_clearance for gap in (1e-9, 1e-10)
    ]
    assert near[1] / near[0] == pytest.approx(10, rel=1e-4)
    apart = cycloid(RV_20E, pin_count=41)  # a tooth difference of two
    assert solve(apart, RV_20E_ERRORS).valid
    preload = jax.tree.map(lambda x: x, RV_20E_ERRORS)
    object.__setattr__(preload, "bearing_clearance", -1 * um)  # as sampling makes it
    shifted = solve(RV_20E, preload).terms.bearing_clearance
    assert shifted == -solve(RV_20E, RV_20E_ERRORS).terms.bearing_clearance
    for profile in ("closed_form", "contact"):
        tight = solve(TRUE_K1, RVErrors(shift_modification=5 * um), profile=profile)
        assert tight.info.status == Status.NOT_ASSEMBLABLE and np.isnan(tight.total) and not tight.valid


@pytest.mark.parametrize(
    ("design", "options", "message"),
    [
        (RV_20E, {"reading": "printed"}, "reading = 'printed'"),
        (RV_20E, {"profile": "exact"}, "profile = 'exact'"),
        (RV_20E, {"reading": "as_printed", "profile": "contact"}, "as_printed"),
        (RV_20E, {"reading": "as_printed", "profile": "closed_form"}, "as_printed"),
        (RV_20E, {"normal_force": 0.5}, "normal_force"),
        (cycloid(RV_20E, pin_count=41), {"profile": "contact"}, "one pin more"),
        (cycloid(RV_20E, pin_count=39), {}, "must exceed disc_teeth"),
    ],
)
def test_method_errors_also_under_jit(design, options, message):
    with pytest.raises(ValueError, match=message):
        geometric(design, RV_20E_ERRORS, **options)
    with pytest.raises(ValueError, match=message):
        solve(design, RV_20E_ERRORS, **options)


def test_constructors_judge_numbers_given_eagerly():
    with pytest.raises(ValueError, match=r"shortening = 1.*K1"):
        cycloid(RV_20E, shortening=1.0)
    with pytest.raises(ValueError, match="bearing_clearance"):
        RV_20E_ERRORS.replace(bearing_clearance=-1 * um)


@pytest.mark.parametrize(
    ("profile", "absolute", "relative"),
    [("first_order", 6e-6, 3e-6), pytest.param("contact", 2e-5, 1e-5, marks=pytest.mark.long)],
)
def test_float32_within_its_bounds(profile, absolute, relative):
    bands = dict(
        pin_circle_radius=10,
        pin_radius=4,
        eccentricity=5,
        equidistant_modification=1,
        shift_modification=3,
        disc_runout=15,
        disc_cumulative_pitch=19,
        pin_hole_clearance=5,
        bearing_clearance=1,
        base_tangent_upper=30,
    )  # um; fmt: skip
    rng = np.random.default_rng(5)
    drawn = {name: np.float32(rng.uniform(-band, band, 4000) * um) for name, band in bands.items()}
    design = cycloid(TRUE_K1, equidistant_modification=0.006 * mm)  # enough room for nearly all

    def run(**errors):
        return geometric(design, RVErrors(**errors), profile=profile)

    single = jax.jit(jax.vmap(lambda e: run(**e)))(drawn)
    double = jax.jit(jax.vmap(lambda e: run(**e)))({name: np.float64(value) for name, value in drawn.items()})
    assert single.total.dtype == jnp.float32 and double.total.dtype == jnp.float64
    both = np.asarray(single.valid & double.valid)
    assert both.mean() > 0.8 and np.mean(single.valid != double.valid) < 1e-3
    size = sum(np.abs(term) for term in jax.tree.leaves(double.terms))
    bound = absolute * arcmin + relative * size
    assert np.all((np.abs(single.total - double.total.astype(np.float32)) <= bound)[both])
