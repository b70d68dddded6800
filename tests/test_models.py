"""What a change costs: a model, an output, a condition of its own, each in one place, up to the page of its answer.

Oracle: the closed form of the fake model (`tests/fake_model`): its twist is linear in its errors, so that mean, spread,
yield and the cheapest tolerances follow with pencil and paper.
"""

import dataclasses
import functools
import math

import jax
import numpy as np
import pytest
from scipy import stats

from rvjax import cli, levels, models, study
from rvjax.catalogue import CORR, RV_20E, RV_40E, RV_320E
from rvjax.designs import RVReducer
from rvjax.dynamics import assemble
from rvjax.errors import RVErrors
from rvjax.outputs import Output, Reading, condition, torque_condition, torque_of
from rvjax.study.response import Response
from rvjax.units import arcsec, rpm, um
from tests.oracles.dynamics import Oracle

TEXT = """
[design]
kind = "key-joint"
keys = 4
radius = "20 mm"
stiffness = "1e9 N/m"
[conditions]
torque = "80 N m"
[tolerances.key_width]
half_width = "6 um"
[tolerances.slot_width]
half_width = "8 um"
[cost.key_width]
reference = "10 um"
finest = "1 um"
coarsest = "100 um"
[cost.slot_width]
scale = 4
reference = "10 um"
finest = "1 um"
coarsest = "100 um"
[requirement.twist]
upper = "100 arcsec"
lower = "-100 arcsec"
target = 0.99
[run]
samples = 4096
certificate_samples = 65536
"""


def test_a_model_costs_one_package_and_one_line(fake_model, answers, undrawn, tmp_path, capsys):
    """A study, an allocation and a page of it."""
    (tmp_path / "joint.toml").write_text(TEXT)
    page, folder = tmp_path / "joint.html", tmp_path / "joint"
    assert cli.main(["report", str(tmp_path / "joint.toml"), "--output", str(page), "--quiet"]) == 0
    text = page.read_text()
    for words in ("Twist over a turn", "as in the conditions", "bending of the key", "torque = 80 N m", "arcsec"):
        assert words in text, words
    assert cli.main(["allocate", str(tmp_path / "joint.toml"), "--results", str(folder), "--quiet"]) == 0
    assert "OPTIMAL" in capsys.readouterr().out
    # The optimum of cost_j / t_j under (t_1^2 + t_2^2 / 4) / (3 r)^2 = s^2, whose mean lies off the middle.
    found = study.load(str(tmp_path / "joint.toml"))
    mean = 80.0 / (4 * 1e9 * 0.02**2)
    share = lambda s: stats.norm.cdf((100 * arcsec - mean) / s) - stats.norm.cdf((-100 * arcsec - mean) / s)  # noqa: E731
    spreads = np.linspace(1e-3, 1e-5, 100_000)
    sd = spreads[np.argmax(share(spreads) >= 0.99)]
    ratio = (4.0 / 0.25) ** (1 / 3)  # t_2 / t_1 by Lagrange: t_j ~ (c_j / b_j)^(1/3)
    key = sd * 3 * 0.02 / math.sqrt(1 + ratio**2 / 4)
    cheapest = 10e-6 / key + 4 * 10e-6 / (ratio * key)
    result = __import__("json").loads((folder / "result.json").read_text())
    assert cheapest <= result["cost"]["after"] <= 1.02 * cheapest
    assert found.output("twist").shown == ("arcsec", arcsec)


def test_a_curve_needs_no_more_of_the_design_than_what_is_asked():
    """The misfit is one without load; the RV-20E lacks the bearing stiffness that a load needs."""
    kind = models.kind(RV_20E)
    assert kind.curve(("lost_motion",)) is None
    given = kind.conditions(output_torque=100.0, angles=8, closure="first_order")
    _, values = kind.curve(("misfit",)).evaluate(RV_20E, RV_20E.error_record(), given)
    assert np.isfinite(values).all()


def test_a_design_from_nothing_names_what_is_missing(fake_model):
    made = study.parse_study(TEXT, name="x").design
    assert (made.keys, made.radius, made.stiffness) == (4, 0.02, 1e9)
    for line, words in (("radius", r"design: radius in m missing"), ("keys", "design: keys missing")):
        bad = "\n".join(row for row in TEXT.splitlines() if not row.startswith(line))
        with pytest.raises(study.StudyError, match=words):
            study.parse_study(bad, name="x")
    with pytest.raises(study.StudyError, match=r"turns.*at most 10"):
        study.parse_study(TEXT.replace("[conditions]", "[conditions]\nturns = 11"), name="x")
    with pytest.raises(study.StudyError, match=r"one of drive, coast"):
        study.parse_study(TEXT.replace("[conditions]", "[conditions]\nside = 'left'"), name="x")


def test_an_output_costs_one_place(fake_model, monkeypatch):
    more = {**fake_model.DESCRIPTION.outputs, "twice": Output("rad", "two twists", lambda *case: (2.0, 0))}
    monkeypatch.setattr(fake_model, "DESCRIPTION", dataclasses.replace(fake_model.DESCRIPTION, outputs=more))
    asked = study.parse_study(TEXT + '\n[requirement.twice]\nupper = "3 rad"\n', name="x")
    assert float(asked.response()(asked.design.error_record()).value["twice"]) == 2.0
    assert (
        levels.as_given(asked.design, ["twice"], asked.conditions, tolerances=asked.tolerances)["twice"].bound is None
    )
    kept = levels.choose(
        asked.design, ["twice"], asked.conditions, tolerances=asked.tolerances, accuracy={"twice": 1e-3}
    )
    assert kept["twice"].settings == () and "was measured" in kept["twice"].why


def test_an_output_that_is_not_required_is_not_computed(fake_model, monkeypatch):
    """Two outputs that raise an error as soon as they are computed: directly, and through a shared result."""

    def computed(*_):
        raise RuntimeError("computed")

    more = {
        "alone": Output("rad", "raises", computed),
        "shared": Output("rad", "raises", Reading((computed,), computed)),
    }
    described = dataclasses.replace(fake_model.DESCRIPTION, outputs={**fake_model.DESCRIPTION.outputs, **more})
    monkeypatch.setattr(fake_model, "DESCRIPTION", described)
    asked = study.parse_study(TEXT, name="x")
    errors = asked.design.error_record()
    assert set(asked.response()(errors).value) == {"twist"}
    for name in more:
        with pytest.raises(RuntimeError, match="computed"):
            Response.of(asked.design, ("twist", name), asked.conditions)(errors)


def test_a_condition_says_how_it_is_read():
    for about in (dict(), dict(unit="furlong"), dict(minimum=1)):
        with pytest.raises(ValueError, match="condition 'speed'"):
            condition(1, "speed", **about)


def test_conditions_of_two_models_agree():
    """One that two models read is declared alike; the joined class has each once."""
    joined = dataclasses.fields(models.kind(RV_320E).conditions)
    names = [f.name for f in joined]
    assert len(set(names)) == len(names) and names.count("output_torque") == 1
    assert sum(f.metadata["torque"] for f in joined) == 1
    with pytest.raises(ValueError, match="no model takes a float"):
        models.kind(1.0)


def test_one_program_serves_every_design(fake_model):
    """The response is a record: its numbers are arguments."""
    asked = study.parse_study(TEXT, name="x")
    run = jax.jit(lambda response, errors: response(errors).value["twist"])
    errors = asked.design.error_record(key_width=-2 * um, slot_width=3 * um)
    for radius in (0.02, 0.03, 0.05):
        response = Response.of(asked.design.replace(radius=radius), ("twist",), asked.conditions)
        expected = 5e-6 / radius + 80.0 / (4 * 1e9 * radius**2)
        assert float(run(response, errors)) == pytest.approx(expected, rel=1e-14)
    assert run._cache_size() == 1


def test_a_reducer_from_nothing_is_the_one_it_describes():
    """Every number of the RV-320E as a study file gives it; standard gears from teeth and module alone."""
    lines = ["[design]", 'kind = "rv"']
    for part in ("involute", "cycloid", "cranks", "inertia", "stiffness"):
        for f in dataclasses.fields(getattr(RV_320E, part)):
            value, unit = getattr(getattr(RV_320E, part), f.name), f.metadata["unit"]
            if value is not None:
                lines.append(f"{part}.{f.name} = {value}" if unit == "-" else f'{part}.{f.name} = "{value!r} {unit}"')
    rest = '\n[tolerances.disc_bore]\nhalf_width = "5 um"\n[requirement.transmission_error]\nupper = "1 arcmin"\n'
    made = study.parse_study("\n".join(lines) + rest, name="x", solve=False).design
    want = RV_320E.replace(mesh_variation=None, damping=None, bearings=None)
    assert jax.tree.structure(made) == jax.tree.structure(want)
    np.testing.assert_array_equal(jax.tree.leaves(made), jax.tree.leaves(want))
    kept = [
        row
        for row in lines
        if not row.startswith("involute.") or row.split()[0][9:] in ("sun_teeth", "planet_teeth", "module")
    ]
    derived = study.parse_study("\n".join(kept) + rest, name="x", solve=False).design.involute
    assert derived.centre_distance == pytest.approx(63e-3)
    assert derived.sun_base_radius == pytest.approx(10.57e-3, abs=0.005e-3)  # as printed


def test_ratio():
    """The printed ratios: 105 (RV-40E, Table 1), and 1 + 69 x 40 / 15 = 185 of the RV-320E."""
    assert RV_40E.ratio == 105.0 and RV_320E.ratio == 185.0


DYNAMIC = """
[design]
base = "rv-320e"
damping.modal_ratio = 0.02
[conditions]
output_torque = "3136 N m"
sun_speed = "1500 rpm"
slowest_sun_speed = "1400 rpm"
fastest_sun_speed = "1600 rpm"
[tolerances.disc_pin_stiffness]
half_width = 0.2
[tolerances.turning_arm_stiffness]
half_width = 0.1
[requirement.vibration]
upper = "5 arcsec"
[requirement.resonance_margin]
lower = 0.02
"""


def test_the_torque_of_conditions_is_found_or_zero():
    @dataclasses.dataclass
    class Still:
        speed: float = condition(1.0, "of the shaft", unit="rad/s")

    loaded = models.kind(RV_40E).conditions(output_torque=412.0)
    assert (torque_condition(loaded), torque_of(loaded)) == ("output_torque", 412.0)
    assert (torque_condition(Still()), torque_of(Still())) == ("", 0.0)


def test_dynamics_is_an_output_of_studies(thorough):
    """Oracles: eigenvalues of the assembled matrices, the dense first-order solution, differences of plain values."""
    asked = study.parse_study(DYNAMIC, name="x", solve=False)
    run = jax.jit(lambda response, errors: response(errors))  # one program for both pairs of speeds
    response = functools.partial(run, asked.response())
    errors = RVErrors(disc_pin_stiffness=0.07, turning_arm_stiffness=-0.03)
    found = response(errors)
    system = assemble(errors.stiffened(asked.design))
    root = 1 / np.sqrt(np.asarray(system.mass))
    squares, shapes = np.linalg.eigh(root[:, None] * np.asarray(system.stiffness) * root)
    turning = np.abs((root[:, None] * shapes)[system.labels.index("output.rotation")]) > 1e-6
    frequency = np.sqrt(squares[turning & (squares > 1e-6 * squares.max())]) / (2 * np.pi)
    mesh = [speed * rpm / (2 * np.pi) * 15 * (1 - 1 / 185) for speed in (1400, 1600)]
    margin = min(max(mesh[0] / f - 1, 1 - mesh[1] / f) for f in frequency)
    assert float(found.value["resonance_margin"]) == pytest.approx(margin, rel=1e-9)
    dense = Oracle(errors.stiffened(asked.design))
    amplitude = dense.first_order("planetary", dense.frequency("planetary", 1500 * rpm), 9, -3136.0)
    rotation = np.asarray(amplitude)[:, system.labels.index("output.rotation")]
    assert float(found.value["vibration"]) == pytest.approx(np.sqrt(np.sum(np.abs(rotation) ** 2) / 2), rel=1e-9)
    assert int(found.status) == 0
    if thorough:  # a program of its own; test_derivatives.py has every output of studies by default
        slope = jax.grad(lambda e: response(e).value["resonance_margin"])(errors)
        step = 1e-5
        moved = [response(errors.replace(disc_pin_stiffness=0.07 + s)).value for s in (-step, step)]
        plain = [float(value["resonance_margin"]) for value in moved]
        assert float(slope.disc_pin_stiffness) == pytest.approx((plain[1] - plain[0]) / (2 * step), rel=1e-5)
    through_rest = dict(slowest_sun_speed=1600 * rpm, fastest_sun_speed=-1400 * rpm)  # in either order
    conditions = dataclasses.replace(asked.conditions, **through_rest)
    margin = run(dataclasses.replace(asked, conditions=conditions).response(), errors).value["resonance_margin"]
    assert float(margin) == pytest.approx(min(1 - mesh[1] / f for f in frequency), rel=1e-9)
    with pytest.raises(study.StudyError, match=r"conditions\.sun_speed is missing: vibration needs it"):
        study.parse_study(DYNAMIC.replace('sun_speed = "1500 rpm"\n', "", 1), name="x", solve=False)
    nothing = RV_40E.error_record(disc_pin_stiffness=0.1).stiffened(RV_40E)
    assert isinstance(nothing, RVReducer) and nothing.stiffness is None and CORR.kind == "oscillatory-roller"
