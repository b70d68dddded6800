"""Friction in studies: outputs, conditions, errors of input, and the section of the page.

Oracles: `running.losses` of the same unit, and pencil and paper for the page.
"""

import re
import sys
import tomllib
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import Friction, RVErrors, models, running, study
from rvjax.catalogue import CYCLOIDAL_17, RV_40E
from rvjax.commands.report import friction as page
from rvjax.commands.report.friction import BAND, SPEEDS, TORQUES, UnitLosses
from rvjax.loaded import MACHINE, unchecked
from rvjax.render import Report
from rvjax.running import outputs
from rvjax.running.losses import PLACES, Turn
from rvjax.status import SolveInfo
from rvjax.study.response import Response

FRICTION = Friction(ring_pins=0.05, output_pins=0.04, arm_bearings=0.002, input_drag=0.01, input_viscous=1e-4)
DRIVE = CYCLOIDAL_17.replace(friction=FRICTION)
TEXT = """
[design]
base = "cycloidal-17"
{design}
[conditions]
{conditions}
[tolerances.ring_pin_friction]
half_width = 0.4
[requirement.{name}]
{limit}
"""
SET = 'friction = {ring_pins = 0.05, output_pins = 0.05, input_drag = "0.01 N m"}'
LOAD, SPEED = 'output_torque = "8.8 N m"\n', 'output_speed = "20 rpm"\n'


def text(name, design=SET, conditions=LOAD + SPEED, limit='upper = "1 N m"'):
    return TEXT.format(design=design, conditions=conditions, name=name, limit=limit)


def told(plan, call, torques, start=None):
    """Losses by a formula of the unit, the torque and its sign, in the place of equilibria; the worst of two angles."""
    own, size = call.friction, jnp.abs(torques) * (1 + call.read.errors.pin_radius + jnp.where(torques > 0, 0.1, 0.0))
    share = jnp.stack([size, 1.5 * size])
    places = {name: jnp.zeros_like(share) for name in PLACES} | {
        "ring_pins": own.ring_pins * share + call.read.design.stiffness.eccentric_bearing * 1e-8,
        "output_pins": own.output_pins * share,
    }
    info = SolveInfo(*(jnp.full(share.shape, value) for value in (jnp.int32(0), jnp.int32(1), 0.0)))
    return Turn(places, own.output_drag, own.input_viscous, own.static_factor, call.read.design.ratio, info, share)


def test_outputs_are_the_losses_of_the_unit(monkeypatch):
    """The output turns backwards, so a positive torque drives the input; equilibria are told by a formula.

    `test_outputs_pay_for_the_equilibria_that_they_read` and the references have those of the model.
    """
    for module in (outputs, sys.modules["rvjax.running.losses"]):
        monkeypatch.setattr(module, "around", told)
    design = DRIVE.replace(cycloid=DRIVE.cycloid.replace(force_angle=0.1))  # no other test has this program
    errors = unchecked(DRIVE.error_record(), pin_radius=0.3, ring_pin_friction=0.2)
    given = models.kind(design).conditions(output_torque=8.8, output_speed=-2.0, running_samples=7)
    names = ("efficiency", "backward_efficiency", "starting_torque", "no_load_torque", "power_loss")
    found = jax.jit(Response.of(design, names, given))(errors)
    due = running.losses(design, errors, output_torque=8.8, output_speed=-2.0, samples=7)
    for name in names:
        np.testing.assert_allclose(found.value[name], getattr(due, name), rtol=1e-9, err_msg=name)
    assert abs(due.power_loss / (2.0 * 8.8 * (1 / due.efficiency - 1)) - 1) > 1e-4  # the sets differ
    assert found.value["efficiency"] > 0.5 and found.value["power_loss"] > 0


SETS = [  # torque, speed, outputs, torques of the equilibria
    (8.8, 1.0, ("efficiency",), (8.8,)),
    (-8.8, 1.0, ("backward_efficiency",), (-8.8,)),
    (8.8, -1.0, ("power_loss",), (8.8,)),
    (8.8, 1.0, ("starting_torque", "no_load_torque"), (0.0,)),
    (8.8, 1.0, ("power_loss", "efficiency"), (8.8,)),
    (-8.8, 1.0, ("power_loss", "starting_torque"), (0.0, -8.8)),
    (8.8, 1.0, ("starting_torque", "efficiency", "backward_efficiency"), (0.0, 8.8, -8.8)),
]


@pytest.mark.parametrize(("torque", "speed", "names", "due"), SETS)
def test_outputs_pay_for_the_equilibria_that_they_read(monkeypatch, torque, speed, names, due):
    asked = []
    real = outputs.turned
    monkeypatch.setattr(outputs, "turned", lambda d, e, g, torques: asked.append(torques) or real(d, e, g, torques))
    given = models.kind(DRIVE).conditions(output_torque=torque, output_speed=speed, running_samples=2)
    jax.eval_shape(Response.of(DRIVE, names, given), DRIVE.error_record())
    assert asked == [due]


REFUSED = [
    (dict(name="efficiency", design="", limit="lower = 0.8"), "design.friction is missing: efficiency needs it"),
    (
        dict(name="starting_torque", design=SET.replace("= {", "= {support_bearings = 0.1, ")),
        "support_bearings: must be",
    ),
    (dict(name="starting_torque", design=SET.replace("= {", "= {gear_meshes = 0.1, ")), "gear_meshes = 0.1: must be 0"),
    (
        dict(name="starting_torque", design=SET.replace("0.05", "-0.05", 1)),
        "ring_pins = -0.05: must be zero or positive",
    ),
    (
        dict(name="efficiency", conditions=SPEED, limit="lower = 0.8"),
        "conditions.output_torque = 0 N m: must not be 0; an efficiency needs a torque",
    ),
    (dict(name="efficiency", conditions=LOAD, limit="lower = 0.8"), "output_speed is missing: efficiency needs it"),
    (dict(name="no_load_torque", conditions=LOAD), "conditions.output_speed is missing: no_load_torque needs it"),
    (
        dict(name="power_loss", conditions=LOAD + 'output_speed = "0 rpm"\n', limit='upper = "1 kW"'),
        "conditions.output_speed = 0 rad/s: must not be 0",
    ),
    (dict(name="power_loss", limit='upper = "1 N m"'), "'N m'.* is not one of W, kW"),
    (dict(name="starting_torque", conditions='span = "crank_turn"\n'), "conditions.span = 'crank_turn': no response"),
    (dict(name="starting_torque", conditions="running_samples = 0\n"), "running_samples = 0: must be an integer"),
]


@pytest.mark.parametrize(("changes", "words"), REFUSED, ids=[words[:40] for _, words in REFUSED])
def test_what_a_study_of_friction_refuses(changes, words):
    with pytest.raises(study.StudyError, match=words) as raised:
        study.parse_study(text(**changes), name="x", solve=False)
    assert "\n" not in str(raised.value)


def test_a_study_reads_shares_units_and_the_parts_of_friction():
    found = study.parse_study(text("power_loss", limit='upper = "0.2 kW"\ntarget = 0.99'), name="x", solve=False)
    assert found.requirements["power_loss"].upper == 200 and found.read_in["power_loss"] == "kW"
    assert found.conditions.running_samples == 24 and found.conditions.output_speed == pytest.approx(2 * np.pi / 3)
    assert float(found.tolerances.ring_pin_friction.upper) == 0.4
    assert {"friction.ring_pins", "friction.output_pins"} <= {number.path for number in found.numbers}
    assert "0.33 L^2" in found.left_out[0] and "lubricant film" in found.left_out[0]
    assert (
        study.parse_study(text("starting_torque", conditions=""), name="x", solve=False).conditions.output_speed is None
    )


def test_an_rv_reducer_needs_the_bearings_that_its_friction_names():
    given = models.kind(MACHINE).conditions(output_torque=412.0, output_speed=1.0)
    bare = MACHINE.replace(bearings=None, friction=Friction(arm_bearings=0.002))
    with pytest.raises(ValueError, match=r"bearings = None: Friction.arm_bearings needs them"):
        Response.of(bare, ("efficiency",), given)
    with pytest.raises(ValueError, match=r"design.stiffness is missing: efficiency needs it, with sun_support"):
        Response.of(RV_40E.replace(stiffness=None, friction=Friction()), ("efficiency",), given)
    assert isinstance(bare.error_record(), RVErrors)


def losses():
    """Five units whose losses are 12 N m + (5 + k) % of the torque, k from 0; 8 N m of drag at 1.5 rad/s."""
    torque, k = 100.0 * np.array(TORQUES), np.arange(5.0)[:, None]
    places = {
        "ring_pins": 4 + (0.05 + 0.01 * k) * torque,
        "output_pins": np.zeros((5, 8)),
        "drag": np.full((5, 8), 8.0),
    }
    under = {name: each[:, TORQUES.index(1.0)] for name, each in places.items()}
    speeds = 1.5 * np.array(SPEEDS)
    return UnitLosses(torque, 100.0, 1.5, speeds, places, under, np.full(5, 2.0), failed=1, samples=6)


def test_the_section_of_the_page():
    found = losses()
    np.testing.assert_allclose(found.efficiency[1, 2, 5], 100 / (100 + 12 + 7))
    np.testing.assert_allclose(found.efficiency[2, 2, 5], 100 / (100 + 12 + 7 + 3 * 1.5 * 2))  # four times the speed
    np.testing.assert_allclose(found.proportion[2, 5], 0.11)
    low, median, high = (100 * np.quantile(100 / (112 + np.arange(6, 10)), share) for share in BAND)
    question = study.parse_study(
        text("efficiency", design='friction.ring_pins = 0.05 # rig of 2025\nfriction.output_pins = 0.04 # assumed',
             limit="lower = 0.8"), name="x", solve=False,
    )  # fmt: skip
    said = Report("", (page.friction_section(found, question),)).text()
    assert f"{median:.1f} [{low:.1f}, {high:.1f}]" in said
    lines = said.splitlines()
    rows = {line.split("  ")[0]: line for line in reversed(lines)}  # the first of each name
    assert "output pins" not in [line[:11] for line in lines[: lines.index(rows["sum"])]]
    assert rows["ring pins"].split()[2:6] == ["9", "11.5", "59.0", "%"]  # of 4 + 5 %, and of 4 + 7.5 %, of 100 N m
    assert rows["sum"].split()[1:3] == ["17", "19.5"]
    assert "L = 0.11 in the median unit" in said
    assert "warning: L is above 0.25 at 20 N m and below" in said  # L = 0.075 + 4/T
    friction = said[said.index("Friction of the study") :]
    assert "rig of 2025" in friction and "-40 to +40 %" in friction
    assert "assumed (usual: 0.03 to 0.10, assumed)" in friction
    assert "Not modelled: friction (first order" in said and "1 further units have no value" in said


def test_a_unit_without_any_loss_has_no_shares():
    nothing = losses()
    for each in (*nothing.places.values(), *nothing.under.values()):
        each[:] = 0
    question = study.parse_study(text("efficiency", limit="lower = 0.8"), name="x", solve=False)
    said = Report("", (page.friction_section(nothing, question),)).text()
    assert "nan" not in said and "100.0 [100.0, 100.0]" in said


def test_the_study_of_the_docs():
    text = (Path(__file__).parent.parent / "docs" / "friction.md").read_text("utf-8")
    first, unit = re.findall(r"^```toml\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    found = study.parse_study(first, name="docs", solve=False)
    assert set(found.requirements) == {"starting_torque", "efficiency"} and found.doubts == []
    assert {number.path for number in found.numbers if number.assumed} >= {"friction.ring_pins", "friction.output_drag"}
    assert study.kind_of(found.design).name == "an RV reducer" and set(tomllib.loads(unit)["errors"]) <= set(
        vars(found.design.error_record())
    )


def test_hysteresis_at_the_probe_angles_and_back_driving_in_the_direction_of_motion(monkeypatch):
    """Widths 1 + cos(18 angle/ratio) at the probe angles; the largest counts, and the worst status."""
    info = SolveInfo(jnp.int32(0), jnp.int32(1), jnp.float64(0))

    def width(design, errors, *, input_angle, **_):
        return running.Hysteresis(1 + jnp.cos(18 * input_angle / DRIVE.ratio), jnp.float64(1), info)

    def back(design, errors, *, direction, samples, **_):
        return running.BackDriving(jnp.float64(samples + {"forward": 0.25, "backward": 0.75}[direction]), info)

    monkeypatch.setattr(outputs, "hysteresis", width)
    monkeypatch.setattr(outputs, "back_driving", back)
    kind, names, errors = models.kind(DRIVE), ("hysteresis", "back_driving_torque"), DRIVE.error_record()
    for speed, due in ((None, 6.25), (1.0, 6.25), (-1.0, 6.75)):
        angle = np.pi / 2 * DRIVE.ratio / 18  # a quarter of a crank turn
        given = kind.conditions(output_speed=speed, running_samples=6, probe_angles=3, input_angle=angle)
        found = Response.of(DRIVE, names, given)(errors)
        assert float(found.value["back_driving_torque"]) == due and int(found.status) == 0
        phases = np.pi / 2 + 2 * np.pi * np.arange(3) / 3
        np.testing.assert_allclose(found.value["hysteresis"], np.max(1 + np.cos(phases)))
