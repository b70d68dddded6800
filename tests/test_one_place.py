"""What a further error, cost law or observation costs: one place, and every layer that reads it sees it.

The fakes are declared here, once each; nothing else of rvjax or of the fake model (`tests/fake_model`) is patched.
"""

import csv
import dataclasses
import re
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cli_study import answered_once

from rvjax import cli, errors, measured, models, mounting, study
from rvjax.catalogue import RV_40E
from rvjax.commands import identify as identified
from rvjax.commands.allocate import answer
from rvjax.designs import CamRollerReducer, RVReducer
from rvjax.errors import Bound, RVErrors, deviation, read_by
from rvjax.outputs import Observation
from rvjax.plotting import new_axes
from rvjax.records import IN_ERROR_UNIT, Scalar, field, record
from rvjax.study.goals import refuse_variable
from rvjax.study.kinds.scaling import Following
from rvjax.tolerances import sample
from rvjax.tolerances.allocation import cost
from rvjax.units import arcsec, um

JOINT = """
[design]
kind = "key-joint"
keys = 2
radius = "20 mm"
stiffness = "1e9 N/m"
[tolerances.key_width]
half_width = "6 um"
[tolerances.hub_centre]
runout = "10 um"
[requirement.twist]
upper = "100 arcsec"
"""


def test_an_error_is_one_place(fake_model, monkeypatch, tmp_path, capsys):
    """A runout of the hub: read from a study, drawn, saved by element, reported; refused where none reads it."""

    @record
    class Errors(fake_model.KeyJointErrors):
        hub_centre: Scalar = deviation(
            "m", "teeth of the hub, x, y", shape=(2,), part=errors.part("hub", stage="shaft"), vector="xy",
            placed=True, read_by=("key_joint",),
        )  # fmt: skip

    monkeypatch.setattr(fake_model.KeyJoint, "error_record", Errors)
    (tmp_path / "joint.toml").write_text(JOINT)
    asked = study.load(str(tmp_path / "joint.toml"))
    assert (float(asked.tolerances.hub_centre.upper), asked.tolerances.hub_centre.shape) == (5 * um, (2,))
    drawn = sample(asked.tolerances, 3, seed=1)
    assert 0 < float(jnp.hypot(*drawn.hub_centre)) < 5 * um
    saved = tmp_path / "units.csv"
    command = ["montecarlo", str(tmp_path / "joint.toml"), "--samples", "64", "--quiet"]
    assert cli.main([*command, "--save", str(saved), "--save-errors"]) == 0
    with saved.open(newline="") as file:
        rows = list(csv.DictReader(file))
    lengths = [np.hypot(float(row["hub_centre[0] [m]"]), float(row["hub_centre[1] [m]"])) for row in rows]
    assert len(rows) == 64 and 0 < max(lengths) <= 5 * um * (1 + 1e-12)
    capsys.readouterr()
    assert cli.main(["check", str(tmp_path / "joint.toml")]) == 0
    assert "hub_centre" in capsys.readouterr().out
    assert errors.STAGES["hub"] == "shaft" and errors.described(Errors, "part")["hub_centre"] == "hub"

    @record
    class Unread(fake_model.KeyJointErrors):
        hub_centre: Scalar = deviation("m", "x, y", shape=(2,), part="hub", vector="xy", placed=True)

    monkeypatch.setattr(fake_model.KeyJoint, "error_record", Unread)
    with pytest.raises(study.StudyError, match=r"tolerances\.hub_centre: required responses do not use it"):
        study.parse_study(JOINT, name="x")


@record
class MoreErrors(RVErrors):
    """A bevel of each bore, carried by its disc, and a bound without a place that follows from it."""

    bore_bevel: Scalar = deviation(
        "m", "bevel of the bores", shape=("discs", "cranks"), part=errors.DISCS, read_by=("loaded",), placed=True,
        carried_by="disc", breaks_pitch=True,
    )  # fmt: skip
    largest_bevel: Scalar = deviation(
        "m", "largest bevel", part=errors.DISCS, read_by=("lost_motion",), bounds=Bound("bore_bevel", jnp.max)
    )


def test_an_error_of_a_disc_is_one_place(monkeypatch):
    """Its parts carry it from slot to slot, its bound follows, and a turn of the cranks is no longer like the next."""
    monkeypatch.setattr(RVReducer, "error_record", MoreErrors)
    parts = {"disc_0": {"bore_bevel": np.array([1 * um, 2 * um])}, "disc_1": {"bore_bevel": np.array([3 * um, 4 * um])}}
    turned = {"disc_0": 0, "disc_1": 1}
    found = mounting.unit_errors(RV_40E, parts, turned)
    assert mounting.disc_mountings(RV_40E, 1)[1].turn == 1  # by one crank spacing
    np.testing.assert_array_equal(found.bore_bevel, [[1 * um, 2 * um], [4 * um, 3 * um]])
    assert float(found.bounded(("largest_bevel",)).largest_bevel) == 4 * um
    assert errors.placed_by(MoreErrors, "lost_motion")[-1] == "bore_bevel"
    assert "bore_bevel" in read_by(MoreErrors, "loaded") and "bore_bevel" not in read_by(MoreErrors, "four_bar")
    full = MoreErrors.for_design(RV_40E, disc_bore=1 * um)
    assert full.bore_bevel == 0.0 and full.disc_bore.shape == (2, 2, 2)
    text = '[design]\nbase = "rv-40e"\n[tolerances.bore_bevel]\nhalf_width = "1 um"\n'
    asked = study.parse_study(text + '[requirement.lost_motion]\nupper = "2 arcmin"\n', name="x", solve=False)
    assert asked.response().bounds == ("largest_bevel",)
    with pytest.raises(study.StudyError, match="bore_bevel: required responses do not use it"):
        study.parse_study(text + '[requirement.misfit]\nupper = "2 um"\n', name="x", solve=False)


def test_a_kind_of_reducer_is_one_place(fake_model, monkeypatch, tmp_path, capsys):
    """Of a key joint: facts, warnings, what cannot be, what follows what, a drawing; studies and commands show them."""

    def refuse(design):
        if design.keys > 6:
            raise ValueError(f"design.keys = {design.keys}: must be at most 6")

    longer = study.Law("keys", ("stiffness",), {"radius": 2.0}, (0.5, 2.0), "by hand")
    kind = study.Kind(
        design=fake_model.KeyJoint,
        name="a key joint",
        facts=lambda design: [("keys of both parts", str(2 * design.keys))],
        refuse=refuse,
        doubts=lambda design: ["design.keys: known joints have 3"] if design.keys != 3 else [],
        rated={"joint": 1.0},
        following=Following((longer,), bound={"radius": ("stiffness",)}, instead={"stiffness": "the radius"}),
        drawing=study.Drawing(lambda design: new_axes(), str, lambda *both: new_axes(), "both joints"),
    )
    monkeypatch.setitem(study.KINDS, fake_model.KeyJoint, kind)
    monkeypatch.chdir(tmp_path)
    text = JOINT.replace('[tolerances.hub_centre]\nrunout = "10 um"', '[conditions]\ntorque = "80 N m"')
    (tmp_path / "joint.toml").write_text(text)
    assert cli.main(["check", "joint.toml", "--picture", "joint.png"]) == 0
    said = capsys.readouterr().out
    for words in ("keys of both parts               4", "warning: design.keys: known joints have 3", "up to 1 N m",
                  "warning: conditions.torque = 80 N m: known reducers have up to 1 N m"):  # fmt: skip
        assert words in said, words
    assert (tmp_path / "joint.png").stat().st_size > 1000
    made = study.load("joint.toml", solve=False)
    assert study.kind_of(made.design) is kind
    assert study.scaled(made.design, {"radius": 30e-3}).stiffness == pytest.approx(1.5**2 * 1e9)
    with pytest.raises(study.StudyError, match=r"design\.keys = 7: must be at most 6"):
        study.parse_study(text.replace("keys = 2", "keys = 7"), name="x")
    with pytest.raises(ValueError, match=r"design\.stiffness is given, but follows it"):
        refuse_variable(made.design, "radius", made.given)
    with pytest.raises(ValueError, match=r"variable\.stiffness: follows from the radius"):
        refuse_variable(made.design, "stiffness", ())
    assert cli.main(["check", "corr", "--picture", "corr.png"]) == 2
    assert "and key joints only, not a CamRollerReducer" in capsys.readouterr().err


def test_a_kind_that_is_not_described_is_one_of_which_nothing_is_known(fake_model):
    """No facts, no law, no drawing; a class below a described one is of its kind."""
    joint = fake_model.KeyJoint(keys=2, radius=0.02, stiffness=1e9)
    plain = study.kind_of(joint)
    assert [*study.facts_of(joint)] == plain.doubts(joint) == [] and plain.drawing is None and plain.bases == {}
    larger = study.scaled(joint, {"radius": 0.04}, whole=True)
    assert (larger.keys, larger.radius, larger.stiffness) == (2, 0.04, 1e9)

    class Special(RVReducer):
        """An RV reducer."""

    assert study.kind_of(Special(RV_40E.involute, RV_40E.cycloid, RV_40E.cranks)) is study.KINDS[RVReducer]


def test_a_model_may_take_several_kinds(fake_model, monkeypatch):
    """Its outputs are those of both, and studies find both by their names."""

    @record
    class Spline(fake_model.KeyJoint):
        kind: ClassVar[str] = "spline"

    classes = (RVReducer, Spline)
    described = dataclasses.replace(fake_model.DESCRIPTION, design=classes)
    monkeypatch.setattr(fake_model, "DESCRIPTION", described)
    assert models.kinds()["spline"] is Spline and models.kinds()["rv"] is RVReducer
    assert all("twist" in models.kind_of(one).outputs for one in classes)
    assert "twist" not in models.kind_of(CamRollerReducer).outputs


JOINT_COST = """
[tolerances.slot_width]
half_width = "8 um"
[cost.key_width]
reference = "10 um"
finest = "1 um"
coarsest = "100 um"
[run]
samples = 4096
certificate_samples = 80000
"""


@pytest.mark.long  # as all dear tests of this file, a job of the workflow; errors and kinds of reducers by default
def test_a_cost_law_is_one_place(fake_model, undrawn, monkeypatch, tmp_path):
    """A law in steps of a currency per micron: read from a study, allocated, on the page of the answer; a table too.

    Oracle: Lagrange for the two errors of a linear response, as in `test_models`.
    """

    @record
    class Linear(cost.Cost):
        """rate (coarsest - t)."""

        name: ClassVar[str] = "linear"
        finest: Scalar = field(IN_ERROR_UNIT, "smallest half-width", sign="positive")
        coarsest: Scalar = field(IN_ERROR_UNIT, "largest half-width", sign="positive")
        rate: Scalar = field("-", "currency for a micron", default=1.0)

        def __call__(self, half_width):
            return self.rate * (self.coarsest - half_width) / um

    try:
        text = JOINT.replace('[tolerances.hub_centre]\nrunout = "10 um"', "").replace(
            "upper =", 'lower = "-100 arcsec"\nupper ='
        )
        text += JOINT_COST + '[cost.slot_width]\nmodel = "linear"\nfinest = "2 um"\ncoarsest = "60 um"\nrate = 0.25\n'
        asked = study.parse_study(text, name="x")
        found = asked.costs["slot_width"]
        assert (found.coarsest, found.rate) == (pytest.approx(60 * um), 0.25) and float(
            found(20 * um)
        ) == pytest.approx(10)
        with pytest.raises(study.StudyError, match=r"cost\.slot_width\.finest is missing: smallest half-width, in m"):
            study.parse_study(text.replace('finest = "2 um"\n', ""), name="x")
        with pytest.raises(study.StudyError, match=r"cost\.slot_width\.model = 'liner'.*linear"):
            study.parse_study(text.replace('"linear"', '"liner"'), name="x")
        table = text.replace(
            '"linear"\nfinest = "2 um"\ncoarsest = "60 um"\nrate = 0.25',
            '"table"\nhalf_widths = ["2 um", "8 um"]\ncosts = [9, 1]',
        )
        assert float(study.parse_study(table, name="x").costs["slot_width"](4 * um)) == pytest.approx(
            3
        )  # half way in logs
        (tmp_path / "joint.toml").write_text(text)
        with answered_once():
            answered = answer.answer(study.load(str(tmp_path / "joint.toml")))
            page = tmp_path / "joint.html"
            assert cli.main(["report", str(tmp_path / "joint.toml"), "--output", str(page), "--quiet"]) == 0
        half = {name: float(getattr(answered.after.tolerances, name).half_width) for name in answered.study.costs}
        slope_key, slope_slot = 10 * um / half["key_width"] ** 2, 0.25 / um
        # d cost / d t over d variance / d t, variance = t_key^2 + t_slot^2 / 2 in parts of (3 r)^2
        assert slope_key / (2 * half["key_width"]) == pytest.approx(slope_slot / half["slot_width"], rel=0.05)
        first = re.search(r'"points": ?\[\[([^,]+),([^]]+)\]', page.read_text())
        assert [float(x) for x in first.groups()] == pytest.approx([2.0, 0.25 * 58])  # um, currency
    finally:
        del cost.COSTS["linear"]


JOINT_BENCH = """
[conditions]
torque = "80 N m"
[identify]
model = "key_joint"
noise = "0.5 arcsec"
[identify.unknown.stiffness]
lower = "5e8 N/m"
upper = "2e9 N/m"
distribution = "uniform"
"""


@pytest.mark.long
def test_an_observation_is_one_place(fake_model, monkeypatch, tmp_path, capsys):
    """The loop of a joint under a rising and falling torque: its keys are as stiff as those that made the data.

    Oracle: least squares of a straight line through the same data.
    """

    def angle(design, errors, given, torques):
        return jax.vmap(
            lambda torque: fake_model.DESCRIPTION.outputs["twist"].evaluate(
                design, errors, dataclasses.replace(given, torque=torque)
            )[0]
        )(torques)

    text = JOINT.replace('[tolerances.hub_centre]\nrunout = "10 um"', "").partition("[requirement")[0] + JOINT_BENCH
    with pytest.raises(study.StudyError, match=r"no model of a design of kind 'key-joint' can be measured"):
        study.parse_study(text, name="x")
    described = dataclasses.replace(fake_model.DESCRIPTION, observations=(Observation("loop", angle),))
    monkeypatch.setattr(fake_model, "DESCRIPTION", described)
    (tmp_path / "joint.toml").write_text(text)
    rising = np.linspace(-100.0, 100.0, 120)
    torque = np.concatenate([rising, rising[::-1]])
    noise = 0.5 * arcsec * np.random.default_rng(4).standard_normal(240)
    twist = -torque / (2 * 1.2e9 * 0.02**2) - 3 * um / 0.02 + noise  # the bench twists against the torque of the keys
    lines = [f"{t!r},{a / arcsec!r}" for t, a in zip(torque.tolist(), twist.tolist())]
    (tmp_path / "loop.csv").write_text("torque [N m],angle [arcsec]\n" + "\n".join(lines))
    found = identified.answer(study.load(str(tmp_path / "joint.toml")), measured.read([tmp_path / "loop.csv"]))
    slope, start = np.polyfit(torque, twist, 1)
    by_name = {field: np.ravel(found.posterior.value[field]) for field in ("stiffness", "key_width")}
    assert float(by_name["stiffness"][0]) == pytest.approx(-1 / (slope * 2 * 0.02**2), rel=2e-3)
    assert float(by_name["key_width"][0]) == pytest.approx(-start * 0.02, abs=0.05 * um)
    capsys.readouterr()
    assert cli.main(["identify", str(tmp_path / "joint.toml"), str(tmp_path / "loop.csv"), "--quiet"]) == 0
    assert "stiffness" in capsys.readouterr().out
    with pytest.raises(study.StudyError, match=r"identify\.nuisance = 'mounting'"):
        study.parse_study(text.replace("[identify]", '[identify]\nnuisance = ["mounting"]'), name="x")
