"""Ball bearings: ratings against the standards and plain Python, lives against closed forms, studies and drawings.

References: ISO 281 (factors of its table, printed to 0.1), ISO 76 (Hertzian pressure of 4200 MPa), a 6204 of makers.
"""

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cli_study import DRAWING
from cycloidal_cases import dictionaries
from life_cases import BASIC, NAMED, duty_of, plain, unit_of
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

import rvjax
from rvjax import BallBearing, Bearings, RollerBearing, Status, catalogue, cli, geometry, life, study
from rvjax.commands.init import written
from rvjax.loaded import unchecked
from rvjax.records import promote
from rvjax.running.inputs import _read_of
from rvjax.units import mm
from tests.oracles import cycloidal as oracle

SMALL = BallBearing(8, 7.938 * mm, 33.5 * mm)  # 6204
DESIGN, ERRORS = unit_of(NAMED[BASIC])
DUTY = duty_of(NAMED[BASIC])
ROLLERS = DESIGN.bearings
ARM = BallBearing(9, 6 * mm, 32 * mm)
BALL_ARM = ROLLERS.replace(arm=ARM)


def factor(g, inner=0.52, outer=0.52):
    """fc, as ISO/TR 1281-1 prints it."""
    groove = (inner * (2 * outer - 1) / (outer * (2 * inner - 1))) ** 0.41
    rings = (1 + (1.04 * ((1 - g) / (1 + g)) ** 1.72 * groove) ** (10 / 3)) ** -0.3
    return 0.95 * 39.9 * rings * g**0.3 * (1 - g) ** 1.39 / (1 + g) ** (1 / 3) * (2 * inner / (2 * inner - 1)) ** 0.41


def dynamic(b):
    """C in N."""
    d, cosine = b.ball_diameter / mm, math.cos(b.contact_angle)
    g = b.ball_diameter * cosine / b.pitch_diameter
    size = d**1.8 if d <= 25.4 else 3.647 * d**1.4
    fc = factor(g, b.inner_groove, b.outer_groove)
    return b.rating_factor * fc * (b.rows * cosine) ** 0.7 * b.balls ** (2 / 3) * size


@pytest.mark.parametrize(("g", "formula", "table"), [(0.05, 46.3, 46.7), (0.10, 55.1, 55.5), (0.20, 59.5, 59.9)])
def test_the_factor_of_the_rating_is_that_of_the_standard(g, formula, table):
    """C of one ball of 1 mm with bm = 1 in one row, over Z^(2/3); the table of ISO 281 within 1 %."""
    ball = BallBearing(6, 1 * mm, 1 / g * mm, rating_factor=1.0)
    found = float(life.dynamic_rating(ball)) / 6 ** (2 / 3)
    assert found == pytest.approx(factor(g), rel=1e-12) and found == pytest.approx(formula, abs=0.05)
    assert found == pytest.approx(table, rel=0.01)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        dict(inner_groove=0.515, outer_groove=0.53),
        dict(rows=2, contact_angle=0.5),
        dict(ball_diameter=30 * mm, pitch_diameter=140 * mm),
    ],
)
def test_dynamic_ratings_agree_with_plain_python(changes):
    bearing = SMALL.replace(**changes)
    assert float(life.dynamic_rating(bearing)) == pytest.approx(dynamic(bearing), rel=1e-12)


def test_a_6204_has_the_ratings_of_its_makers():
    """C from 12.7 to 13.5 kN, C0 = 6.55 kN in catalogues."""
    assert 12.7e3 * 0.95 < float(life.dynamic_rating(SMALL)) < 13.5e3 * 1.05
    assert float(life.static_rating(SMALL)) == pytest.approx(6.55e3, rel=0.02)


def test_large_balls_have_another_power_without_a_jump():
    at = lambda d: float(life.dynamic_rating(BallBearing(8, d * mm, 5 * d * mm)))  # noqa: E731
    assert at(25.4 * (1 + 1e-9)) == pytest.approx(at(25.4), rel=1e-3)
    assert at(50.8) / at(25.4 * (1 + 1e-9)) == pytest.approx(2**1.4, rel=1e-8)
    assert at(25.4) / at(12.7) == pytest.approx(2**1.8, rel=1e-9)


def static_factor(g):
    """f0: load of a ball at 4200 MPa over 5 D^2, on the ring that reaches it first; steel, grooves 0.52 and 0.53."""

    def load(across, groove):
        curvatures = 4 + across - 1 / groove
        lean = abs(across + 1 / groove) / curvatures

        def missing(k):
            m = 1 - 1 / k**2
            return ((k * k + 1) * ellipe(m) - 2 * ellipk(m)) / ((k * k - 1) * ellipe(m)) - lean

        k = brentq(missing, 1.0001, 500)
        a = (2 * k * k * ellipe(1 - 1 / k**2) / np.pi * 3 * (1 - 0.3**2) / (curvatures * 207e3)) ** (1 / 3)
        return (4200 * np.pi * a * a / (1.5 * k)) ** 3

    return min(load(2 * g / (1 - g), 0.52), load(-2 * g / (1 + g), 0.53)) / 5


@pytest.mark.parametrize("g", [0.01, 0.05, 0.09, 0.1, 0.15, 0.205, 0.3, 0.35, 0.4])
def test_the_static_rating_is_the_pressure_of_iso_76(g):
    """The table has one digit after the point, so 0.06 of 9 to 17; between two values it is linear."""
    found = float(life.static_rating(BallBearing(6, 1 * mm, 1 / g * mm))) / 6
    assert found == pytest.approx(static_factor(g), abs=0.06)


def test_the_static_rating_by_the_table():
    """f0 = 14.15 half-way between 14.2 and 14.0 would be 14.1; two rows and the contact angle enter once each."""
    bearing = BallBearing(7, 2 * mm, 2 / 0.195 * mm)
    assert float(life.static_rating(bearing)) == pytest.approx(14.1 * 7 * 4, rel=1e-9)
    inclined = BallBearing(7, 2 * mm, 2 / 0.19 * math.cos(0.4) * mm, rows=2, contact_angle=0.4)
    assert float(life.static_rating(inclined)) == pytest.approx(14.2 * 2 * 7 * 4 * math.cos(0.4), rel=1e-9)


def test_given_ratings_stand():
    given = SMALL.replace(capacity=13.5e3, static_capacity=6.55e3)
    assert float(life.dynamic_rating(given)) == 13.5e3 and float(life.static_rating(given)) == 6.55e3


def test_the_exponent_of_balls_is_three():
    """Constant load: (C/P)^3; two loads: cubic mean."""
    rating = dynamic(SMALL)
    found = life.bearing_life(SMALL, [[0.6 * rating / 5, 0.8 * rating / 5]])
    assert float(found.life) == pytest.approx(125e6, rel=1e-12)
    found = life.bearing_life(SMALL, [[1000.0, 0.0], [0.0, 3000.0]], weight=[3.0, 1.0])
    assert float(found.load) == pytest.approx((0.75 * 1e9 + 0.25 * 27e9) ** (1 / 3), rel=1e-12)
    assert int(life.bearing_life(SMALL, [[0.0, 0.0]]).info.status) == Status.UNLOADED


def test_ratings_have_the_slopes_of_differences():
    both = jax.jit(lambda b: jnp.log(life.dynamic_rating(b)) + jnp.log(life.static_rating(b)))
    bearing = promote(SMALL.replace(contact_angle=0.2))
    slope = jax.grad(both)(bearing)
    for name in ("ball_diameter", "pitch_diameter", "inner_groove", "outer_groove", "rating_factor", "contact_angle"):
        own = getattr(bearing, name)
        ends = [both(unchecked(bearing, **{name: own * share})) for share in (1 - 1e-6, 1 + 1e-6)]
        due = (ends[1] - ends[0]) / (2e-6 * own)
        assert float(getattr(slope, name)) == pytest.approx(float(due), rel=1e-6, abs=1e-7), name


def test_single_precision_is_kept():
    single = jax.tree.map(lambda x: jnp.asarray(x, jnp.float32), SMALL)
    found = life.bearing_life(single, jnp.asarray([[1e3, 0.0]], jnp.float32))
    assert found.life.dtype == jnp.float32
    assert float(found.life) == pytest.approx(1e6 * (dynamic(SMALL) / 1e3) ** 3, rel=2e-5)


static = jax.jit(life.static_rating)


@jax.jit
@partial(jax.value_and_grad, has_aux=True)
def traced(bearing):
    found = life.bearing_life(bearing, [[1e3, 0.0]])
    return found.life, found


@pytest.mark.parametrize(
    ("changes", "status"),
    [
        (dict(ball_diameter=np.nan), Status.NONFINITE),
        (dict(capacity=np.inf), Status.NONFINITE),
        (dict(pitch_diameter=-1.0), Status.INVALID_GEOMETRY),
        (dict(ball_diameter=14 * mm), Status.INVALID_GEOMETRY),  # they overlap
        (dict(ball_diameter=5 * mm, pitch_diameter=11 * mm), Status.INVALID_GEOMETRY),  # beyond the tables; 3 balls
        (dict(inner_groove=0.5), Status.INVALID_GEOMETRY),
        (dict(outer_groove=1.1), Status.INVALID_GEOMETRY),
        (dict(rating_factor=0.0), Status.INVALID_GEOMETRY),
        (dict(contact_angle=2.0), Status.INVALID_GEOMETRY),
    ],
)
def test_traced_balls_that_cannot_be_have_a_status(changes, status):
    base = SMALL if "pitch_diameter" not in changes else BallBearing(3, 5 * mm, 20 * mm)
    bearing = unchecked(plain(base.replace(capacity=13e3)), **{k: np.asarray(v) for k, v in changes.items()})
    (_, found), slope = traced(bearing)
    assert int(found.info.status) == status and np.isnan(found.life) and np.isnan(found.load)
    assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(slope))
    if "capacity" not in changes:
        assert np.isnan(static(bearing))


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: BallBearing(2, 1.0, 10.0), "BallBearing.balls = 2: must be an integer of at least 3"),
        (lambda: BallBearing(8, 1.0, 10.0, rows=0), "BallBearing.rows = 0: must be an integer of at least 1"),
        (lambda: BallBearing(8, 20 * mm, 10 * mm), "ball_diameter = 0.02 m: must be less than pitch_diameter = 0.01 m"),
        (lambda: BallBearing(9, 4 * mm, 10 * mm), "ball_diameter = 0.004 m: must be at most .*; 9 balls overlap"),
        (lambda: BallBearing(3, 5 * mm, 10 * mm), "ball_diameter = 0.005 m: must be at most 0.4 of pitch_diameter"),
        (lambda: SMALL.replace(inner_groove=0.5), "BallBearing.inner_groove = 0.5: must be above 0.5"),
        (lambda: SMALL.replace(outer_groove=52.0), "BallBearing.outer_groove = 52: must be above 0.5 and at most 1"),
        (lambda: SMALL.replace(contact_angle=15.0), "BallBearing.contact_angle = 15 rad: must lie between 0 and pi/2"),
        (lambda: Bearings(arm=SMALL.replace(contact_angle=0.3)), "Bearings.arm.contact_angle = 0.3 rad: must be 0"),
        (
            lambda: Bearings(arm=SMALL, support=SMALL.replace(contact_angle=0.3)),
            "Bearings.support.contact_angle = 0.3 rad: must be 0 for a BallBearing",
        ),
        (lambda: Bearings(arm=SMALL, support=SMALL, preload=90.0), "Bearings.preload: is of tapered supports"),
        (
            lambda: life.bearing_life(SMALL, [[1.0, 0.0]], method="slices"),
            'method = "slices": must be "basic"; BallBearing has balls',
        ),
        (
            lambda: life.rating(DESIGN.replace(bearings=BALL_ARM), ERRORS, DUTY, method="raceway"),
            'method = "raceway": must be "basic"; Bearings.arm has balls',
        ),
        (
            lambda: life.rating(DESIGN.replace(bearings=ROLLERS.replace(support=SMALL)), ERRORS, DUTY, method="slices"),
            'method = "slices": must be "basic"; Bearings.support has balls',
        ),
        (
            lambda: life.bearing_life(SMALL.replace(capacity=13.0), [[1.0, 0.0]]),
            "BallBearing.capacity = 13 N: .* ISO 281 and ISO 76 give these balls",
        ),
        (lambda: life.dynamic_rating(ROLLERS), "takes a design of kind RollerBearing or BallBearing, got Bearings"),
    ],
)
def test_what_cannot_be_is_one_line(call, words):
    with pytest.raises(ValueError, match=words) as raised:
        call()
    assert "\n" not in str(raised.value)


def test_the_outline_and_the_friction_read_balls():
    """A bore fits around the balls; a moment of friction reads the pitch diameter alone."""
    drive = catalogue.CYCLOIDAL_17.replace(bearings=Bearings(arm=SMALL.replace(ball_diameter=4 * mm)))
    bore = geometry.outline(drive, part="disc").circles[-1]
    assert bore.name == "bore" and float(bore.radius) == pytest.approx((33.5 + 4) / 2 * mm)
    read = _read_of(drive.bearings, rvjax.Friction(arm_bearings=0.002))
    assert jax.tree.leaves(read) == [33.5 * mm, 0.0]


STUDY = """
[design]
base = "cycloidal-17"
{}
[conditions]
life_samples = 4
[[duty]]
output_torque = "8.8 N m"
output_speed = "60 rpm"
time = "1 h"
[tolerances.throw]
half_width = "10 um"
[requirement.life]
lower = "1000 h"
target = 0.95
"""
BALLS = 'bearings.arm = {{balls = 11, ball_diameter = "2.5 mm", pitch_diameter = "14.5 mm"{}}}'


def parsed(design, more=""):
    return study.parse_study(STUDY.format(design).replace("[[duty]]", f"{more}\n[[duty]]"), name="x", solve=False)


def test_a_study_reads_balls_in_the_place_of_rollers():
    arm = parsed(BALLS.format("")).design.bearings.arm
    assert type(arm) is BallBearing and (arm.balls, arm.rating_factor) == (11, 1.3)  # not the factor of rollers
    assert float(arm.ball_diameter) == 2.5 * mm
    dotted = 'bearings.arm.pitch_diameter = "15 mm"'
    changed = parsed(dotted).design.bearings.arm
    assert catalogue.part_class(Bearings, "arm", ["pitch_diameter"], ARM) is BallBearing  # as the base has
    assert type(changed) is RollerBearing and changed.rollers == 11 and changed.pitch_diameter == 15 * mm


@pytest.mark.parametrize(
    ("design", "more", "words"),
    [
        (
            "bearings.arm.balls = 8", "",
            "design.bearings.arm: ball_diameter in m, pitch_diameter in m missing; a BallBearing takes no number from "
            "the RollerBearing",
        ),
        ('bearings.arm.ball_diameter = "2 mm"', "", "design.bearings.arm: balls, pitch_diameter in m missing"),
        (BALLS.format(", rollers = 11"), "", "design.bearings.arm: rollers and balls: give one of them"),
        (BALLS.format(", roller_length = 3"), "", "design.bearings.arm.*roller_length"),
        (BALLS.format(', capacity = "3 N"'), "", "design.bearings.arm.capacity = 3 N: must be at least"),
        (
            BALLS.format(""), 'life_method = "raceway"',
            'conditions.life_method = "raceway": must be "basic"; design.bearings.arm has balls',
        ),
    ],
)  # fmt: skip
def test_a_study_of_balls_that_cannot_be_is_one_line(design, more, words):
    with pytest.raises(study.StudyError, match=words) as raised:
        parsed(design, more)
    assert "\n" not in str(raised.value)


def test_a_study_of_balls_is_checked(tmp_path, capsys, request, thorough):
    """In the long profile with its life; by default test_life_systems.py has lives of such bearings."""
    if not thorough:
        request.getfixturevalue("unsolved")
    (tmp_path / "balls.toml").write_text(STUDY.format(BALLS.format("")))
    assert cli.main(["check", str(tmp_path / "balls.toml")]) == 0
    shown = capsys.readouterr().out
    assert "bearings.arm.ball_diameter" in shown and "No warnings" in shown
    if not thorough:
        return
    found = float(shown.split(">= 1000 h")[1].split("h")[0].replace(",", ""))
    drive = parsed(BALLS.format("")).design
    angles = -17 / 18 * 2 * np.pi * np.arange(4) / 4  # of the shaft against the carrier over a turn against the discs
    turn = [oracle.equilibrium(dictionaries(drive), {}, input_angle=a, output_torque=8.8) for a in angles]
    size = np.linalg.norm([each["disc_bearing"] for each in turn], axis=-1)
    rates = np.mean(size.reshape(4, 2) ** 3, axis=0) / dynamic(drive.bearings.arm) ** 3 * 18 / 1e6
    assert found == pytest.approx(1 / 3600 / np.sum(rates ** (10 / 9)) ** 0.9, rel=1e-3)


def test_a_drawing_may_have_balls(tmp_path):
    """Rollers of a known reducer are no numbers of a ball bearing, so that the drawing needs all of it."""
    own = 'bearings.arm.balls = 9\nbearings.arm.pitch_diameter = "26 mm"\n'
    file = tmp_path / "drawing.toml"
    file.write_text(DRAWING + own)
    with pytest.raises(ValueError, match=r"lacks bearings\.arm\.ball_diameter"):
        written(str(file))
    file.write_text(DRAWING + own + 'bearings.arm.ball_diameter = "5 mm"\n')
    bearings = study.parse_study(written(str(file)).text, name="x", solve=False).design.bearings
    assert type(bearings.arm) is BallBearing and type(bearings.support) is RollerBearing


def test_wider_discs_leave_balls_as_they_are():
    """A roller is as long as the disc; C of rollers by the length^(7/9), of balls not at all."""
    whole_one = catalogue.RV_40E_WHOLE
    with_balls = whole_one.replace(bearings=whole_one.bearings.replace(arm=ARM.replace(capacity=12e3)))
    wider = {"contact.face_width": 1.5 * whole_one.contact.face_width}
    found = study.scaled(with_balls, wider)
    assert float(found.bearings.arm.capacity) == 12e3
    assert found.stiffness.turning_arm_bearing == with_balls.stiffness.turning_arm_bearing
    assert study.scaled(whole_one, wider).stiffness.turning_arm_bearing > whole_one.stiffness.turning_arm_bearing
