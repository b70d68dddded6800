"""Losses, back-driving torque, hysteresis and joint model: reference cases, invariants, statuses, derivatives."""

import functools
import sys
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import running_cases as cases
from loaded_cases import plain
from running_cases import TOGETHER
from scipy.optimize import brentq

from rvjax import Friction, Status, running
from rvjax.loaded import unchecked
from rvjax.running.losses import PLACES

BASIC = "rv40: all errors and shares"  # its program serves most tests of losses
CASE = cases.NAMED[BASIC]
DESIGN, ERRORS = cases.unit_of(CASE)
FRICTION, OPTIONS = cases.friction_of(CASE), CASE["options"]
TIGHT = cases.NAMED["rv40: tight pins, no torque"]
STEP = 1e-5  # of differences
COMMON = (
    *(*TOGETHER, "rv40: loop, no errors", "rv40: loop, tight pins", "rv40: loop, play", "rv40: joint, all errors"),
    *("cycloidal: no errors", "cycloidal: all errors, the output drives"),
)  # the others need a program for each


def case_of(errors=ERRORS, friction=FRICTION, design=DESIGN, **changes):
    """Numbers of losses with some changed."""
    return design, errors, friction, OPTIONS | changes


def losses(*given, **changes):
    """Losses by the one program of cases next to each other."""
    return cases.losses(OPTIONS["samples"], case_of(*given, **changes))[0]


@pytest.mark.parametrize(
    "name",
    [name if name in COMMON else pytest.param(name, marks=pytest.mark.long) for name in cases.NAMED],
)
def test_cases_agree_with_the_independent_evaluation(name):
    case = cases.NAMED[name]
    rtol = 1e-6 if case["kind"] in ("joint", "hysteresis") else 1e-7
    cases.assert_agrees(cases.solved(case), case["expect"], rtol)


def values(found):
    """Floating results of losses."""
    return {name: float(x) for name, x in vars(found).items() if name != "info"}


def test_places_sum_and_powers_balance():
    """The sum of the places is the loss, and input less output power is the power that is lost, to rounding."""
    ratio, speed = DESIGN.ratio, OPTIONS["output_speed"]
    for torque in (412.0, -412.0):
        found = losses(output_torque=torque)
        parts = sum(float(getattr(found, name)) for name in (*PLACES, "drag"))
        assert parts == pytest.approx(float(found.loss_torque), rel=1e-14)
        into, out = float(found.input_torque) * ratio * speed, torque * speed
        assert into - out == pytest.approx(float(found.power_loss), rel=1e-13)


def test_losses_are_linear_in_every_coefficient_and_a_share_is_its_factor():
    pairs = (
        ("ring_pin_friction", ("ring_pins",)),
        ("arm_bearing_friction", ("arm_bearings",)),
        ("support_bearing_friction", ("support_bearings",)),
        ("gear_mesh_friction", ("gear_meshes",)),
        ("drag_friction", tuple(name for name, share in running.SHARES.items() if share == "drag_friction")),
    )
    given = [case_of()]
    for share, names in pairs:
        more = 1 + float(getattr(ERRORS, share))
        given.append(case_of(unchecked(ERRORS, **{share: 2 * more - 1})))
        given.append(case_of(friction=FRICTION.replace(**{name: 2 * getattr(FRICTION, name) for name in names})))
    base, *found = map(values, cases.losses(OPTIONS["samples"], *given))
    for (share, names), by_share, by_number in zip(pairs, found[::2], found[1::2]):
        for name, value in by_share.items():
            assert value == pytest.approx(by_number[name], rel=1e-12), (share, name)
        changed = [place for place in (*PLACES, "drag") if by_share[place] != pytest.approx(base[place], rel=1e-12)]
        own = {"arm_bearings", "support_bearings", "drag"} if share == "drag_friction" else set(names)
        assert set(changed) == own
        if share != "drag_friction" and share not in ("arm_bearing_friction", "support_bearing_friction"):
            assert by_share[names[0]] == pytest.approx(2 * base[names[0]], rel=1e-12)


def test_motion_backwards_mirrors_a_unit_without_errors():
    none = cases.unit_of(cases.NAMED["rv40: no errors, forward"])[1]
    one, other = values(losses(none)), values(losses(none, output_torque=-412.0, output_speed=-OPTIONS["output_speed"]))
    assert other.pop("input_torque") == pytest.approx(-one.pop("input_torque"), rel=1e-9)
    for name, value in one.items():
        assert other[name] == pytest.approx(value, rel=1e-9, abs=1e-9), name


def test_at_rest_only_the_factor_counts_and_no_viscous_drag():
    """The static factor changes starting torque and self-locking alone; viscous drag nothing at rest."""
    slow = losses(output_speed=0.0)
    thick = losses(output_speed=0.0, friction=FRICTION.replace(input_viscous=1.0, output_viscous=90.0))
    assert values(slow) == pytest.approx(values(thick), rel=1e-14) and float(slow.power_loss) == 0
    nearly = values(losses(output_speed=1e-9))
    assert values(slow) | {"power_loss": 0} == pytest.approx(nearly | {"power_loss": 0}, rel=1e-8)
    base, sticky = values(losses()), values(losses(friction=FRICTION.replace(static_factor=2.4)))
    assert sticky.pop("starting_torque") == pytest.approx(2 * base.pop("starting_torque"), rel=1e-12)
    assert sticky == pytest.approx(base, rel=1e-12)
    none = cases.unit_of(cases.NAMED["rv40: no errors, forward"])[1]
    least = 1 / float(1 - losses(none, output_speed=0.0).backward_efficiency)  # all angles are nearly alike
    for factor, locks in ((1.05 * least, 1), (0.95 * least, 0)):
        assert int(losses(none, FRICTION.replace(static_factor=factor)).self_locking) == locks


def test_no_friction_is_no_loss(thorough):
    zero = Friction(
        **{name: 0.0 for name, value in vars(FRICTION).items() if value is not None and name != "static_factor"}
    )
    found = losses(friction=zero.replace(static_factor=1.0))
    assert float(found.efficiency) == float(found.backward_efficiency) == 1 and int(found.self_locking) == 0
    assert float(found.loss_torque) == float(found.starting_torque) == 0
    if thorough:
        due = cases.NAMED["rv40: back, all errors"]
        back = cases.solved(due | dict(friction=vars(plain(zero))))
        assert float(back.torque) == 0 and int(back.info.status) == Status.CONVERGED


def test_the_back_driving_torque_divides_what_locks_from_what_turns(thorough):
    """Losses at a little less and a little more of that of the reference. The long profile has the search among
    equilibria, too; with great friction there is no such torque, or pins are overloaded."""
    for name, status in (
        ("rv40: back, no errors", Status.CONVERGED),
        ("rv40: back, all errors", Status.CONTACT_OVERLOAD),
    ):
        case = cases.NAMED[name]
        torque, (_, errors) = case["expect"]["torque"], cases.unit_of(case)
        for factor, locks in ((1 - 1e-6, 1), (1 + 1e-6, 0)):
            found = losses(errors, cases.friction_of(case), output_torque=factor * torque)
            assert int(found.self_locking) == locks, (name, factor)
        if not thorough:
            continue
        locked = cases.solved(case | dict(friction=case["friction"] | dict(ring_pins=1.0)))
        assert int(locked.info.status) == status and not np.isfinite(locked.torque)
        assert np.isposinf(locked.torque) == (status == Status.CONVERGED)


def searched(friction):
    """The search for a back-driving torque with a friction of a closed form; beyond `most` an equilibrium fails."""
    module = sys.modules["rvjax.running.bench"]

    def resisting(plan, sign, given, x, start):
        status = jnp.where(x > given.bearings, int(Status.CONTACT_OVERLOAD), 0)
        return friction(x, given.errors), status, jnp.int32(1), start

    plan = SimpleNamespace(samples=1, layout=SimpleNamespace(unknowns=1))

    @jax.jit
    @functools.partial(jax.jacfwd, has_aux=True)
    def solve(numbers, most):
        one = jnp.asarray(1.0)
        x, _, info = module._solve(plan, 1.0, module.Given(None, numbers, one, None, most, one))
        return x, (x, info)

    def root(numbers, most=np.inf):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "_resisting", resisting)
            slope, (x, info) = solve(jnp.asarray(numbers), most)
        return float(x), int(info.status), np.asarray(slope), int(info.steps)

    return root


def test_the_search_for_a_back_driving_torque_with_friction_of_a_closed_form():
    def line(x, numbers):
        return numbers[0] + numbers[1] * x

    root = searched(line)
    for a, b in ((20.0, 0.0), (20.0, 0.17), (20.0, 0.9), (1e-6, 0.5)):
        x, status, slope, evaluations = root([a, b])
        assert (x, status) == (pytest.approx(a / (1 - b), rel=1e-9), 0) and evaluations <= 8
        np.testing.assert_allclose(slope, [1 / (1 - b), a / (1 - b) ** 2], rtol=1e-9)
    assert root([0.0, 0.3])[:2] == (0.0, 0)
    for b in (1.0, 1.5, 0.9995):  # no root, or one beyond 1000 times the friction without torque
        x, status, slope, _ = root([20.0, b])
        assert (x, status) == (np.inf, 0) and not slope.any()
    assert root([20.0, 0.9], most=150.0)[1] == Status.CONTACT_OVERLOAD  # the root is at 200
    assert root([20.0, 0.9], most=201.0)[:2] == (pytest.approx(200, rel=1e-9), 0)

    def bent(x, numbers):
        """Steep at first, as where few pins carry."""
        return numbers[0] + numbers[1] * x / (1 + x / numbers[2])

    root, numbers = searched(bent), [5.0, 1.4, 10.0]
    due = brentq(lambda x: x - bent(x, numbers), 0, 1000, xtol=1e-12)
    x, status, _, evaluations = root(numbers)
    assert (x, status) == (pytest.approx(due, rel=1e-9), 0) and evaluations <= 10


@functools.cache
def batch():
    """Lanes of one program and their slopes: the unit, what spoils it one by one, the unit again, and moved twice."""
    nan = np.nan
    lanes = [
        {}, {"ring_pins": -0.1}, {"static_factor": 0.0}, {"gear_meshes": 1.0}, {"drag_friction": -1.5},
        {"output_drag": nan}, {"pitch": 0.0}, {"ring_pin_friction": nan}, {}, {}, {},
    ]  # fmt: skip
    made = []
    for change in lanes:
        friction = unchecked(FRICTION, **{k: v for k, v in change.items() if k in vars(FRICTION)})
        errors = unchecked(ERRORS, **{k: v for k, v in change.items() if k.endswith("_friction")})
        arm = unchecked(DESIGN.bearings.arm, **({"pitch_diameter": 0.0} if "pitch" in change else {}))
        design = DESIGN.replace(bearings=unchecked(DESIGN.bearings, arm=arm))
        made.append((design, errors, friction, OPTIONS))
    return cases.losses_and_slopes(OPTIONS["samples"], made, np.array([0.0] * 9 + [STEP, -STEP]))


def test_a_bad_number_is_a_status_and_leaves_its_neighbours():
    found = jax.tree.map(lambda lanes: lanes[:9], batch()[0])
    bad, wrong = int(Status.NONFINITE), int(Status.INVALID_GEOMETRY)
    assert found.info.status.tolist() == [0, wrong, wrong, wrong, wrong, bad, wrong, bad, 0]
    one = values(losses())
    for name, value in one.items():
        lanes = np.asarray(getattr(found, name))
        assert np.isnan(lanes[1:8]).all(), name
        np.testing.assert_allclose(lanes[[0, 8]], value, rtol=1e-9, err_msg=name)


@pytest.mark.long
def test_single_precision_is_good_to_a_percent():
    design, errors = cases.unit_of(TIGHT)
    lower = jax.tree.map(np.float32, (design, errors, cases.friction_of(TIGHT)))
    for torque in (0.0, 412.0):
        exact = losses(errors, cases.friction_of(TIGHT), output_torque=torque)
        found = running.losses(*lower, output_torque=np.float32(torque), output_speed=np.float32(1.5707963), samples=6)
        assert found.loss_torque.dtype == np.float32 and int(found.info.status) == int(exact.info.status) == 0
        assert float(found.loss_torque) == pytest.approx(float(exact.loss_torque), rel=1e-2)


@pytest.mark.parametrize(
    "name",
    [
        BASIC,
        pytest.param("rv40: back, all errors", marks=pytest.mark.long),
        pytest.param("rv40: loop, tight pins", marks=pytest.mark.long),
        pytest.param("rv40: joint, all errors", marks=pytest.mark.long),
    ],
)
def test_derivatives_are_those_of_the_plain_values(name, thorough):
    """Along one direction that moves design, errors, friction and conditions; the long profile, in reverse too."""
    if name == BASIC:
        found, slopes = batch()
        lanes = jax.vmap(cases.floating)(found)
        (value, *ends), slopes = (lanes[k] for k in (0, 9, 10)), [slopes[0]]
    else:
        (value, slope), *ends = (cases.ALONG(*cases.arguments(cases.NAMED[name], x)) for x in (0.0, STEP, -STEP))
        value, slopes, ends = cases.floating(value), [slope], [cases.floating(found) for found, _ in ends]
    due = (np.asarray(ends[0]) - np.asarray(ends[1])) / (2 * STEP)
    scale = np.abs(np.asarray(value)) + np.abs(due)
    if thorough:
        kind, samples, amount, *unit = cases.arguments(cases.NAMED[name], 0.0)
        slopes += [jax.jit(jax.jacrev(lambda x: cases.floating(cases.shifted(kind, samples, x, *unit))))(amount)]
    for slope in slopes:
        assert np.all(np.abs(np.asarray(slope) - due) <= 1e-6 * scale)


def test_second_calls_compile_nothing(compiled):
    """Of a drive, whose losses are a program for one case."""
    case = cases.NAMED["cycloidal: no errors"]
    cases.solved(case, output_torque=3.0)
    compiled.clear()
    cases.solved(case | dict(friction=case["friction"] | dict(ring_pins=0.07)), output_torque=3.1)
    assert not [event for event in compiled if "compile" in event]
