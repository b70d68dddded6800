"""Corners that the census and the search for worse inputs found, each as a test.

Oracles: closed forms (a roller at dead centre carries its preload, a geared linkage without misfit does not slip), a
grid over the whole flank, the rank of the stiffness matrix. Tolerances: 1e-12 where the same number is formed twice,
1e-9 for a minimum known from a grid; statuses exactly.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import LinkDeviations, RVErrors, Status, catalogue, four_bar, lost_motion, roots
from rvjax._jax.elementary import LARGEST_ANGLE
from rvjax.designs import CrankStage
from rvjax.lost_motion.terms import Flank, free_rotation
from rvjax.mesh_force import laws
from tests.oracles import cam_roller


def test_a_preloaded_roller_at_dead_centre_has_no_arm():
    """Without torque its arm of 1e-16 was a moment that nothing balanced: MAX_STEPS, one case in four hundred."""
    place = np.array([-7, -5, -4, -2, -1, 0, 1, 3, 5, 6, 7, 8]) * np.pi / 6  # one roller within rounding of dead centre
    psi = 2 * place[:, None] - 2 * np.pi * np.arange(3) / 3
    dead = np.abs(np.sin(psi)) < 1e-9
    gap = np.where(dead, 1e-6, np.where(np.cos(psi) > 0, -1e-6, -2e-6))
    case = cam_roller.corr(
        12, 2, eccentricity=2e-3, young_modulus=2e11, angle=place, errors_roller_radius=gap, torque=0.0
    )
    found = cam_roller.solve(2, case, "linear")
    loaded = dead.any(1)
    assert loaded.sum() >= 6
    np.testing.assert_array_equal(found.info.status, np.where(loaded, Status.CONVERGED, Status.UNLOADED))
    np.testing.assert_array_equal(np.asarray(found.cam) > 0, dead)
    # At dead centre all three forces lie on the ray (Wei et al. 2021, Eq. 4).
    np.testing.assert_allclose(found.cam.max(1)[loaded], found.gear.max(1)[loaded], 1e-9)


def test_rounding_at_a_root_does_not_lead_to_another_root():
    """A staircase of width eps round the root at 0; the middle of the bracket is nearly a root as well."""

    def staircase(x, shift):
        steps = jnp.round(x * 2**52) / 2**52
        y = x + jax.lax.stop_gradient(steps - x) - shift
        return y * (y**2 - 0.25) * (y**2 - 0.36)

    shift = np.array([3e-17, -2e-17, 5e-17])
    found = jax.jit(jax.vmap(lambda p: roots.bracketed(staircase, p, -1.0, 1.0, start=0.0)))(shift)
    np.testing.assert_array_equal(found.info.status, Status.CONVERGED)
    assert np.abs(found.value).max() < 4e-16


@jax.jit
@jax.vmap
def geared(case):
    """A linkage of geared cranks with the slopes of its angle, 0 where it has none."""

    def closed(case):
        names = ("crank_3", "joint", "frame_angle")
        deviations = LinkDeviations(**{name: case[name] for name in names})
        found = four_bar.solve_closure(
            case["eccentricity"],
            case["spacing"],
            deviations,
            crank_angle=case["angle"],
            cranks="geared",
            gear_stiffness_ratio=case["ratio"],
        )
        return jnp.where(found.info.status == Status.CONVERGED, found.coupler_angle, 0), found

    return jax.value_and_grad(closed, has_aux=True)(case)


def geared_cranks(**numbers):
    """Cases of columns, (400,), and their slopes; a number holds for all of them."""
    full = dict(
        crank_3=0.0, joint=np.zeros(2), frame_angle=0.0, eccentricity=1.3e-3, spacing=72e-3, angle=2.4, ratio=67.0
    )
    lanes = {name: np.broadcast_to(numbers.get(name, value), (400, *np.shape(value))) for name, value in full.items()}
    (_, found), slope = geared(lanes)
    return found, slope


@pytest.mark.long  # test_four_bar.py has geared parallelograms at rest
def test_geared_cranks_without_misfit_do_not_slip():
    """Soft gears leave other places of rest, which bisection found when rounding kept Newton from halving."""
    rng = np.random.default_rng(0)
    size, angle, turned = 10 ** rng.uniform(-3, -1, 400), rng.uniform(-7, 7, 400), rng.uniform(-0.03, 0.03, 400)
    found, _ = geared_cranks(eccentricity=size, angle=angle, frame_angle=turned, spacing=1.0, ratio=0.15)
    np.testing.assert_array_equal(found.info.status, Status.CONVERGED)
    np.testing.assert_allclose(found.coupler_angle, turned, 1e-12, 1e-15)


@pytest.mark.long  # test_lost_motion_flank.py has a search of the exact contact in all ordinary regions
def test_contact_where_first_order_minima_are_out_of_reach():
    """Deviations beyond the curvature of the flank: the search began where no pin reaches, and ended there."""
    teeth = 39
    rng = np.random.default_rng(1)
    lanes = np.stack([rng.uniform(0.1, 0.95, 300), *rng.uniform(-1.2, 1.2, (2, 300))], 1)
    base = catalogue.RV_40E
    e, pins = 1e-3, teeth + 1

    def play(x):
        radius = e * pins / x[0]
        cycloid = base.cycloid.replace(
            eccentricity=e,
            pin_circle_radius=radius,
            equidistant_modification=e * x[1],
            shift_modification=e * x[2],
            shortening=None,
        )
        found = lost_motion.geometric(base.replace(cycloid=cycloid), RVErrors(), profile="contact")
        ground = radius + e * x[2]
        flank = Flank(e, radius, e * pins / ground, e * x[1], e * x[2], float(teeth))
        grid = jnp.linspace(-20.0, 20.0, 4001)
        rotation = free_rotation(grid, flank)
        best = jnp.argmin(rotation)
        edge = ~jnp.isfinite(rotation[best - 1] + rotation[best + 1])
        return found.total, found.info.status, 2 * rotation[best], edge

    total, status, expected, edge = jax.tree.map(np.asarray, jax.jit(jax.vmap(play))(lanes))
    apart = lanes[:, 2] > lanes[:, 1]
    np.testing.assert_array_equal(status[apart], Status.NOT_ASSEMBLABLE)
    nowhere = ~apart & ~np.isfinite(expected)
    np.testing.assert_array_equal(status[nowhere], Status.INVALID_GEOMETRY)
    inside = ~apart & np.isfinite(expected) & ~edge
    np.testing.assert_array_equal(status[inside], Status.CONVERGED)
    assert inside.sum() > 100
    # A grid of 0.01 lies above the minimum by its square.
    assert (total[inside] <= expected[inside] + 1e-15).all()
    np.testing.assert_allclose(total[inside], expected[inside], 3e-4, 1e-6)


# Springs in the order of `Stiffness`, then crank circle, both base radii, eccentricity, force and pressure angle.
MECHANISMS = np.array([
    [59334747.89576002, 91031.4764509725, 50397769.073954396, 157441.27727857526, 7055014717.117551,
     532243467.29605913, 305553420.0501586, 1370343288.8857896, 0.0, 44172284.3748329, 0.028505839108659812,
     0.0133938234740538, 0.03146095581947544, 0.007406970821219618, -0.3786567190442447, 0.1475161712452229],
    [78479710.44234009, 2533.1853131496187, 1670363286.7878058, 107622.76557176322, 144332819.28839782,
     7278065208.342986, 36876563.063428685, 1659379098.5288453, 0.0, 12400242.143662898, 0.05235133215508134,
     0.04375480853949276, 0.43607976184018793, 0.0017587024912326507, -0.025026983554082838, 0.12320047502801554],
    [276861979.4231343, 5428.835876401473, 64902848.89338402, 13104.791902224304, 1879802904.8645122,
     768314346.0046825, 174347361.46002883, 312669343.09176254, 0.0, 17547265.88042725, 0.024102153703986006,
     0.0043994081151812366, 0.05209808816040097, 0.011606348739680413, -1.039701722582893, 0.4106034994250439],
])  # fmt: skip


def test_a_mechanism_is_singular_whatever_the_pivots_say():
    """Two cranks and one disc do not hold the output sideways. Pivots of 2e-14 passed for stiffness: CONVERGED, with
    a mean deflection that missed the torque by 1e-3. Held sideways, the same reducers are sound."""
    base = catalogue.RV_320E

    def solve(x, support):
        springs = dict(zip(("sun_support", "sun_torsion", "planet_crank_bending", "planet_crank_torsion",
                            "support_bearing", "turning_arm_bearing", "sun_planet_mesh", "disc_pin_mesh",
                            "output_support", "output_torsion"), x))  # fmt: skip
        involute = base.involute.replace(sun_base_radius=x[11], planet_base_radius=x[12], pressure_angle=x[15])
        design = base.replace(
            involute=involute,
            cycloid=base.cycloid.replace(disc_count=1, eccentricity=x[13], force_angle=x[14]),
            cranks=CrankStage(2, x[10]),
            stiffness=base.stiffness.replace(**{**springs, "output_support": support}),
        )
        return rvjax.dynamics.static(design, output_torque=-780.0).info

    solve = jax.jit(jax.vmap(solve, in_axes=(0, None)))
    np.testing.assert_array_equal(solve(MECHANISMS, 0.0).status, Status.SINGULAR)
    held = solve(MECHANISMS, 1e7)
    np.testing.assert_array_equal(held.status, Status.CONVERGED)
    assert np.asarray(held.residual).max() < 1e-11


@pytest.mark.long  # test_four_bar_derivatives.py has lost lanes of geared cranks
def test_geared_cranks_too_soft_for_an_angle_leave_their_neighbours_alone():
    """A slip of 1e30 rad has no angle: NONFINITE, and a gradient that is finite."""
    cases = [dict(), dict(crank_3=-1e30), dict(joint=(-1e30, 1e-4)), dict(eccentricity=1e-300), dict(ratio=1e-30)]
    full = [dict(crank_3=1e-5, joint=(0.0, 0.0), eccentricity=1.3e-3, ratio=67.0) | case for case in cases]
    full += full[:1] * 395
    found, slope = geared_cranks(**{name: np.array([case[name] for case in full]) for name in full[0]})
    due = [Status.CONVERGED, *[Status.NONFINITE] * 4, *[Status.CONVERGED] * 395]
    np.testing.assert_array_equal(found.info.status, due)
    np.testing.assert_array_equal(np.isnan(found.coupler_angle), np.array(due) != Status.CONVERGED)
    assert all(np.isfinite(leaf).all() for leaf in slope.values())
    assert abs(slope["crank_3"][0]) > 1


@jax.jit
@jax.vmap
def transmitted(case):
    """The transmission error of an RV-40E."""
    errors = RVErrors(crank_phase=jnp.stack([case["phase"], 0.0]), bearing_clearance=case["clearance"])
    return four_bar.transmission_error(
        catalogue.RV_40E, errors, crank_angle=case["angle"], output_torque=case["torque"], closure="newton"
    )


def four_units(**numbers):
    """Columns, (4,); a number holds for all of them."""
    full = dict(phase=0.0, clearance=0.0, angle=0.3, torque=0.0) | numbers
    return transmitted({name: np.broadcast_to(value, (4,)) for name, value in full.items()})


def test_phases_beyond_the_trigonometry_are_named():
    found = four_units(phase=np.array([0.99 * LARGEST_ANGLE, -2 * LARGEST_ANGLE, 1e30, 0.0])).info.status
    np.testing.assert_array_equal(found, [Status.CONVERGED, Status.NONFINITE, Status.NONFINITE, Status.CONVERGED])


def test_a_torque_too_small_for_its_square_has_a_status():
    """It was taken for no torque at all: the clearance, which any load takes up whole, was left out."""
    found = four_units(clearance=1e-5, angle=1.0, torque=np.array([1e-300, 1e-140, 1e-20, 0.0]))
    np.testing.assert_array_equal(found.info.status, [Status.NONFINITE] + [Status.CONVERGED] * 3)
    assert np.isnan(found.error[0]) and abs(found.error[1]) > 1e-5 and found.error[3] == 0
    np.testing.assert_allclose(found.error[1], found.error[2], rtol=1e-9)


@pytest.mark.long  # test_four_bar_reducer.py turns a disc beyond a right angle
def test_a_disc_turned_by_half_a_turn_has_a_misfit():
    """A carrier bore of -1e30 m turns the disc over: 1 - cos from s^2 / (1 + cos) was 0 / 0 there."""
    bore = np.zeros((3, 2))
    bore[0, 0] = -1e30
    design = catalogue.RV_40E.replace(cranks=CrankStage(3, 36e-3))
    error = partial(four_bar.transmission_error, design, crank_angle=0.6, closure="newton")
    found = jax.jit(error)(RVErrors(carrier_bore=bore))
    assert found.info.status == Status.CONVERGED and np.isfinite(found.misfit).all()


def test_the_cage_limits_a_load_only_by_its_own_share():
    """A cage that carries a seventieth of the cam force was taken to carry all of it: overload at 0.96 of the limit."""
    cage, gear, cam_radius, gear_radius = 0.0147, 1.0001, 0.718, 0.961
    roller = laws.Compliance(*(jnp.asarray(x) for x in (cage, gear, cam_radius, gear_radius, 1.0)))
    limit = float(laws.load_limit("hertz", roller))
    assert limit == min(1 / 0.718, 1 / 0.961 / 1.0001)
    assert float(laws.load_limit("hertz", roller._replace(cage=jnp.asarray(2.0)))) == 0.5
    # A cam contact alone: the half-width reaches the radius of the roller or of the cam.
    shares = np.linspace(1e-3, 1 - 1e-3, 999)
    assert (1 / np.maximum(shares, (1 - shares) ** 2 / shares)).max() < 2.7


@pytest.mark.long  # a turn beyond a right angle and linkages of any size run by default
def test_the_turn_of_many_discs_of_any_size():
    """Lengths 1e-60 times as long leave all angles; the product of eight vectors vanished, and with it the error."""
    design = catalogue.RV_40E
    design = design.replace(cycloid=design.cycloid.replace(disc_count=8))
    small = design.replace(
        cycloid=design.cycloid.replace(eccentricity=1.3e-63, pin_circle_radius=64e-63),
        cranks=design.cranks.replace(circle_radius=36e-63),
    )
    delta = 1e-6 * np.random.default_rng(0).normal(size=(8, 2))
    figure = jax.jit(
        lambda design, delta: (
            four_bar.revolution(design, RVErrors(crank_eccentricity=delta), angles=16, closure="closed_form").maximum
        )
    )
    np.testing.assert_allclose(figure(small, 1e-60 * delta), figure(design, delta), rtol=1e-9)
    assert figure(design, delta) > 1e-6
