"""Joint models as files: MuJoCo gives their numbers back in experiments, the loss table of Modelica obeys the loss law.

Oracles: the simulator itself, an integration with the law of LossyGear, parsers of the standard library.
"""

import json
import re
import runpy
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np
import pytest

from rvjax import compensation, running
from rvjax.running import FORMATS, Header
from rvjax.status import SolveInfo
from rvjax.units import arcsec

ROOT = Path(__file__).parents[2]
NUMBERS = dict(
    ratio=121.0,
    half_backlash=2e-4,
    stiffness=3.7e5,
    damping=50.0,
    input_friction=10.0,
    output_friction=8.0,
    input_viscous=3.0,
    output_viscous=2.0,
    forward_loss=0.12,
    backward_loss=0.1,
    mu_avg=0.109,
    mu_dif=-0.002,
    rotor_inertia=1.2,
    output_inertia=0.3,
)
HEADER = Header("rv--40e", "nominal", "0.2")
LOAD = 400.0  # N m


def joint(**changes):
    info = SolveInfo(np.int32(0), np.int32(1), np.float64(0))
    return running.Joint(**{**NUMBERS, "info": info, **changes})


def written(form, **changes):
    return FORMATS[form].write(joint(**changes), HEADER)


def test_json_holds_every_number_with_its_unit():
    found = json.loads(written("json", damping=None))
    assert found["format"] == "rvjax-joint" and found["version"] == 1
    assert (found["study"], found["unit"], found["rvjax"]) == ("rv--40e", "nominal", "0.2")
    assert {name: found[name] for name in NUMBERS} == {**NUMBERS, "damping": None}
    assert found["units"]["half_backlash"] == "rad" and set(found["units"]) == set(NUMBERS)
    assert found["not_represented"] == [
        "transmission error",
        "dependence on the angle",
        "curved stiffness",
        "temperature",
    ]


@pytest.mark.parametrize("form", FORMATS)
def test_no_file_has_a_number_that_is_not_finite(form):
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match=r"^mu_dif = (nan|inf): must be finite") as error:
            written(form, mu_dif=bad)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(("form", "name"), [("mjcf", "MJCF"), ("mjcf-soft", "MJCF"), ("modelica", "Modelica")])
def test_a_missing_inertia_is_named(form, name):
    with pytest.raises(
        ValueError, match=rf"^design.inertia is missing: {name} needs output_inertia; .*--output-inertia$"
    ):
        written(form, output_inertia=None)


def test_mujoco_gives_back_backlash_stiffness_and_friction():
    """The rotor is held and the load swings: the loop of torque and angle. Then constant torques until speeds settle.

    A slow loop shows no friction: MuJoCo lets it begin in proportion to the speed.
    """
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(written("mjcf"))
    data, step = mujoco.MjData(model), model.opt.timestep
    assert step <= 0.1 / np.sqrt(3.7e5 * (1 / 1.2 + 1 / 0.3)) * (1 + 1e-12)
    assert model.numeric("forward_loss").data == 0.12 and model.numeric("mu_dif").data == -0.002

    model.dof_armature[model.joint("rotor").dofadr] = 1e9
    mujoco.mj_setConst(model, data)
    count = round(1.0 / step)
    swing = np.concatenate([np.linspace(a, b, count) for a, b in ((0, LOAD), (LOAD, -LOAD), (-LOAD, LOAD))])
    out = model.joint("output").dofadr[0]
    angle = np.empty_like(swing)
    for k, load in enumerate(swing):
        data.qfrc_applied[out] = load
        mujoco.mj_step(model, data)
        angle[k] = data.qpos[out]
    last = slice(2 * count, None)
    up, torque = angle[last], swing[last]
    low, high = torque < -100, torque > 100
    below, above = (np.polyfit(up[part], torque[part], 1) for part in (low, high))
    # load = friction + k (angle +- half_backlash) on the way up
    ends = [-line[1] / line[0] for line in (below, above)]  # angles at which the lines cross zero torque
    np.testing.assert_allclose([below[0], above[0]], 3.7e5, rtol=2e-3)
    np.testing.assert_allclose((ends[1] - ends[0]) / 2, 2e-4, rtol=5e-3)

    model = mujoco.MjModel.from_xml_string(written("mjcf"))
    ends = {}
    for parts, train in (("both", True), ("apart", False)):
        if not train:  # rotor and output turn freely of each other
            model.tendon_stiffness[:] = model.tendon_damping[:] = 0
        speeds = []
        for torque in (60.0, 120.0):
            data = mujoco.MjData(model)
            data.ctrl[0] = torque / 121  # of the motor shaft
            data.qfrc_applied[out] = 0 if train else torque
            mujoco.mj_step(model, data, round(5 / step))
            speeds.append(data.qvel.copy())
        viscous = 60 / (speeds[1] - speeds[0])
        ends[parts] = np.stack([60 - viscous * speeds[0], viscous])
    np.testing.assert_allclose(ends["both"], [[18, 18], [5, 5]], rtol=1e-3)
    np.testing.assert_allclose(ends["apart"], [[10, 8], [3, 2]], rtol=1e-3)


@pytest.mark.parametrize("half", [2e-4, 0.0])
def test_the_soft_file_has_backlash_and_friction_at_a_millisecond(half):
    """Settled speed by hand; the load swings against the held rotor through the backlash, and a little more."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(written("mjcf-soft", half_backlash=half))
    assert model.opt.timestep == 1e-3
    out, rotor = (model.joint(name).dofadr[0] for name in ("output", "rotor"))
    data = mujoco.MjData(model)
    data.ctrl[0] = 60 / 121
    mujoco.mj_step(model, data, 8000)
    assert data.qvel == pytest.approx([(60 - 18) / 5] * 2, rel=1e-6)
    assert data.qpos[rotor] - data.qpos[out] == pytest.approx(half, abs=1e-4)

    model.dof_armature[rotor] = 1e9
    mujoco.mj_setConst(model, data)
    data, angle = mujoco.MjData(model), []
    for load in (LOAD, -LOAD):
        data.qfrc_applied[out] = load
        mujoco.mj_step(model, data, 3000)
        angle.append(data.qpos[out])
    stiff = [sign * (half + LOAD / 3.7e5) for sign in (1, -1)]  # of the elastic train: the constraint is of its size
    assert (
        np.all(np.abs(angle) > half)
        and np.all(np.abs(angle) < 1.5 * np.abs(stiff))
        and np.sign(angle).tolist() == [1, -1]
    )
    head = " ".join(written("mjcf-soft").partition("-->")[0].split())
    assert "timestep is 0.001 s" in head and "stiffness and damping of the train" in head


def test_a_step_of_the_page_has_the_friction_of_the_load():
    """Settled speeds by hand, with the motor driving and with the load driving against it: 18 N m and 5 N m s/rad."""
    mujoco = pytest.importorskip("mujoco")
    page = ROOT / "docs" / "mujoco_friction.py"
    recipe = runpy.run_path(str(page))
    model = mujoco.MjModel.from_xml_string(written("mjcf"))
    out = model.joint("output").dofadr[0]
    for motor, load in ((60.0, 0.0), (60.0, -200.0), (-60.0, 0.0)):
        data = mujoco.MjData(model)
        data.ctrl[0], data.qfrc_applied[out] = motor / 121, load
        for _ in range(round(4 / model.opt.timestep)):
            recipe["step"](model, data)
        sense = np.sign(motor + load)
        friction = 0.109 * abs(motor) * sense - 0.002 * motor + 18 * sense
        assert data.qvel[out] == pytest.approx((motor + load - friction) / 5, rel=2e-3)


def test_mujoco_reads_the_urdf():
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(written("urdf"))
    assert (model.dof_frictionloss, model.dof_damping) == ([18.0], [5.0])
    np.testing.assert_allclose(model.body_inertia[-1], 0.3)
    root = ElementTree.fromstring(written("urdf", output_inertia=None))
    assert float(root.find("transmission/actuator/mechanicalReduction").text) == 121
    assert root.find("joint").get("type") == "continuous"


@pytest.mark.parametrize("form", ["mjcf", "urdf"])
def test_the_head_of_a_file_names_study_unit_version_and_limits(form):
    text = written(form)
    head = text[4 : text.index("-->")]
    assert "--" not in head and "rv- -40e, unit: nominal, rvjax 0.2" in head
    assert "friction in proportion to the load" in " ".join(head.split())


def modelica():
    """Parameters of the components of the written model, and its connections."""
    text = written("modelica")
    lines = text.splitlines()
    assert (
        lines[0].startswith("// ")
        and re.fullmatch(r"end (\w+);", lines[-1])[1] == re.search(r"^model (\w+) ", text, re.M)[1]
    )
    body = text[text.index("\nmodel") : text.index("equation")]
    found = {}
    for name, arguments in re.findall(r"Components\.\w+ (\w+)(?:\((.*?)\))?;", body, re.S):
        found[name] = dict(re.findall(r"(\w+)=(\[[^]]*\]|[^,\s]+)", arguments))
    return found, re.findall(r"connect\(([\w.]+), ([\w.]+)\);", text)


def test_modelica_has_every_part_in_one_chain():
    found, connections = modelica()
    assert float(found["rotor"]["J"]) == pytest.approx(1.2 / 121**2)
    assert {name: float(x) for name, x in found["train"].items()} == {"c": 3.7e5, "d": 50.0, "b": 4e-4}
    assert float(found["output_side"]["J"]) == 0.3 and float(found["damper"]["d"]) == 2.0
    assert found["bearing"]["tau_pos"] == "[0, 8.0]" and float(found["gear"]["ratio"]) == 121
    ends = {end for pair in connections for end in pair}
    assert {end.split(".")[0] for end in ends} == {*found, "flange_a", "flange_b"}
    way, reached = dict(connections), "flange_a"
    chain = []
    while reached in way:
        reached = way[reached].replace("flange_a", "flange_b") if "." in way[reached] else way[reached]
        chain.append(reached.split(".")[0])
        if reached == "flange_b":
            break
    assert chain == ["rotor", "gear", "train", "output_side", "bearing", "flange_b"]


def lossy_gear(table, ratio, tau, speed, driving):
    """Torque that LossyGear gives to the output, for a positive speed of the input."""
    columns = [np.interp(speed, table[:, 0], table[:, k]) for k in (1, 2, 3, 4)]
    columns = [
        table[0, k] + (table[1, k] - table[0, k]) * speed / table[1, 0] if k > 2 else columns[k - 1]
        for k in (1, 2, 3, 4)
    ]
    if driving:
        return ratio * (columns[0] * tau - columns[2])
    return ratio * (tau / columns[1] - columns[3])


@pytest.mark.parametrize(("torque", "loss"), [(300.0, 0.12), (-300.0, 0.1)])
def test_the_loss_table_of_modelica_is_the_loss_law(torque, loss):
    """Input torque (T + D + c w + L |T|)/i of the losses gives T back at every speed."""
    found, _ = modelica()
    rows = [[float(x) for x in row.split(",")] for row in found["gear"]["lossTable"].strip("[]").split(";")]
    table = np.array(rows)
    assert table.shape == (2, 5) and table[1, 0] == 121
    for speed in (0.0, 0.7, 3.0):  # of the output, rad/s
        tau = (torque + 10 + 3 * speed + loss * abs(torque)) / 121
        assert lossy_gear(table, 121, tau, 121 * speed, torque > 0) == pytest.approx(torque, rel=1e-12)


def test_a_self_locking_reducer_has_no_modelica_table():
    with pytest.raises(ValueError, match=r"^backward_loss = 1.2: must be below 1"):
        written("modelica", backward_loss=1.2)
    assert json.loads(written("json", backward_loss=1.2))["backward_loss"] == 1.2


def test_mujoco_reads_a_table_of_correction(tmp_path):
    mujoco = pytest.importorskip("mujoco")
    value = np.array([2.0, 4.0, 3.0]) * arcsec * np.exp(0.3j)
    rows = compensation.table(compensation.correction(np.array([3, 40, 81]), value, ratio=121.0))
    compensation.export(rows, tmp_path / "t.xml", joint={"stiffness": 9.2e6})
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "t.xml"))
    assert (model.numeric("te_correction").data == rows.correction).all()
