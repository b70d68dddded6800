"""The measured table: interpolation, the cheapest level, and scenes that keep the accuracy they ask for.

Oracle: a table made by hand, whose cheapest level follows with pencil and paper; for scenes, the exact level itself on
units, designs and accuracies that the stored table never saw.
"""

import dataclasses
import itertools
import json
import math
import sys
from collections import Counter
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import cli, levels, models, study
from rvjax.catalogue import RV_20E, RV_40E
from rvjax.commands.tradeoff import report
from rvjax.levels import measured
from rvjax.levels.measure import evaluate, limits
from rvjax.levels.table import SAFETY, Level, Model, Table, stored
from rvjax.lost_motion import geometric
from rvjax.plotting import tradeoff as picture
from rvjax.status import Status, succeeded
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.units import arcsec, um


def level(name, largest, ns, precision="float64"):
    return Level(name, dict(angles=8), precision, {"out": largest}, {"out": largest}, ns, 1.0, 1.0, 10)


def model(*levels):
    return Model(
        name="m", outputs={"out": "m"}, case="case", design={"a": 1.0}, spread=0.1, errors={"f": 1e-6},
        sizes=[0.3, 1.0, 3.0], torque=None, conditions={}, typical={"out": [1.0, 1.0, 1.0]}, failed=(0, 1),
        reference="exact", levels=(*levels, level("exact", [0.0, 0.0, 0.0], 100.0)),
    )  # fmt: skip


ROUGH, FINE = level("rough", [1e-3, 1e-2, 1e-1], 1.0), level("fine", [1e-5, 1e-4, 1e-3], 10.0)
BROKEN = level("broken", [1e-9, 1e-9, math.inf], 0.1, "float32")


def test_the_cheapest_level_that_is_twice_as_good_as_asked():
    made = model(ROUGH, FINE)
    for wanted, size, name in (
        (0.021, 1.0, "rough"),
        (0.019, 1.0, "fine"),
        (0.019, 0.9, "rough"),  # 2 * 0.01 * 0.9^1.91
        (1.9e-4, 1.0, "exact"),
        (1.0, 3.1, "exact"),
        (1.0, 0.29, "exact"),
    ):
        assert made.cheapest({"out": wanted}, size).name == name, (wanted, size)
    middle = made.bound(ROUGH, "out", math.sqrt(3.0))
    assert middle == pytest.approx(2 * math.sqrt(1e-2 * 1e-1))


def test_a_level_that_fails_is_not_taken_beyond_the_size_where_it_works():
    made = model(ROUGH, BROKEN)
    assert made.cheapest({"out": 1.0}, 1.0).name == "broken"
    assert made.cheapest({"out": 1.0}, 1.01).name == "rough"


def test_a_level_that_fails_at_a_larger_size_keeps_its_errors_below_it():
    failing = level("failing", [1e-6, 1e-4, math.inf], 1.0)
    errors = [failing.error([0.3, 1.0, 3.0], "out", size) for size in (0.3, 0.3**0.5, 1.0, 1.01)]
    assert errors == pytest.approx([1e-6, 1e-5, 1e-4, math.inf])


def test_errors_never_shrink_with_size():
    odd = level("odd", [1e-2, 1e-4, 1e-3], 1.0)
    assert model(odd).bound(odd, "out", 1.0) == pytest.approx(2e-2)


def test_the_front_and_the_sentence():
    worse = level("worse", [1.0, 0.02, 1.0], 5.0)
    made = model(ROUGH, worse, FINE)
    assert [x.name for x in made.front()] == ["rough", "fine", "exact"]
    sentence = levels.advice(made)
    assert "rough (1 ns)" in sentence and "fine (10 ns)" in sentence and "worse" not in sentence


def test_a_table_comes_back_from_its_file(tmp_path):
    table = Table({"cores": 2}, 0, {"m": model(ROUGH, BROKEN)})
    table.save(tmp_path / "t.json")
    assert Table.load(tmp_path / "t.json") == table
    assert any("broken" in row[0] for row in levels.blocks(table)[0].rows)


def test_every_model_of_the_stored_table_can_be_shown():
    table = stored()
    assert {"transmission_error", "misfit", "lost_motion", "mesh_force", "dynamics"} <= set(table.models)
    figure = picture(table)
    assert sum(axes.get_visible() for axes in figure.axes) == len(table.models)
    for one in table.models.values():
        assert levels.advice(one).startswith(("Take ", "Only ")) and len(one.front()) >= 2


LINKS = dict(crank_eccentricity=Tolerance.symmetric(6.5 * um), disc_bore=Tolerance.symmetric(6.5 * um))
LOADED = models.kind(RV_40E).conditions(output_torque=412.0)


def chosen(accuracy, design=RV_40E, conditions=LOADED, tolerances=None, output="transmission_error"):
    tolerances = tolerances or for_design(design, **LINKS)
    return levels.choose(design, (output,), conditions, tolerances=tolerances, accuracy={output: accuracy})[output]


def test_more_accuracy_costs_more():
    found = [chosen(a * arcsec) for a in (30.0, 3.0, 0.3, 1e-6)]
    assert [c.ns for c in found] == sorted(c.ns for c in found) and found[0].ns < found[-1].ns / 10
    assert all(c.bound <= a * arcsec for c, a in zip(found, (30.0, 3.0, 0.3)) if c.bound is not None)
    assert found[-1].bound is None and "2048" in found[-1].level


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (dict(design=RV_40E.replace(cranks=RV_40E.cranks.replace(circle_radius=50e-3))), "circle_radius"),
        (dict(design=RV_40E.replace(cycloid=RV_40E.cycloid.replace(disc_count=3))), "disc_count"),
        (dict(conditions=dataclasses.replace(LOADED, output_torque=600.0)), "torque"),
        (dict(conditions=dataclasses.replace(LOADED, output_torque=30.0)), "torque"),
        (dict(conditions=dataclasses.replace(LOADED, cranks="free")), "cranks"),
        (dict(tolerances=for_design(RV_40E, disc_bore=Tolerance.symmetric(90 * um))), "disc_bore"),
        (dict(tolerances=for_design(RV_40E, disc_bore=Tolerance.symmetric(0.1 * um))), "disc_bore"),
    ],
)
def test_outside_what_was_measured_the_exact_level(change, word):
    choice = chosen(30 * arcsec, **change)
    assert choice.bound is None and word in choice.why and dict(choice.settings)["closure"] is None


def test_an_output_ignores_errors_that_it_does_not_read():
    design = RV_40E.replace(cycloid=RV_40E.cycloid.replace(equidistant_modification=-20 * um, pin_radius=4e-3))
    tolerances = for_design(design, **LINKS, disc_runout=Tolerance(0.0, 500 * um))
    assert chosen(30 * arcsec, design, tolerances=tolerances).bound is not None


def test_a_number_given_in_place_of_the_derived_one_was_not_measured():
    """All levels were measured with K1 = e z_p / r_p; the printed 0.72 of the RV-20E is another reducer."""
    derived = RV_20E.cycloid.eccentricity * RV_20E.cycloid.pin_count / RV_20E.cycloid.pin_circle_radius
    tolerances = for_design(RV_20E, pin_radius=Tolerance.symmetric(4 * um))
    for k1, approximate in ((None, True), (derived * (1 + 1e-15), True), (0.72, False)):
        design = RV_20E.replace(cycloid=RV_20E.cycloid.replace(shortening=k1))
        choice = chosen(3 * arcsec, design, models.kind(design).conditions(), tolerances, "lost_motion")
        assert (choice.bound is not None) == approximate and ("cycloid.shortening = 0.72" in choice.why) != approximate


def test_an_accuracy_must_make_sense():
    with pytest.raises(ValueError, match="positive"):
        chosen(0.0)
    with pytest.raises(ValueError, match="not required"):
        levels.choose(RV_40E, ("misfit",), LOADED, tolerances=for_design(RV_40E), accuracy={"lost_motion": 1.0})


def test_a_study_states_its_accuracy():
    whole = study.load("rv-40e", solve=False)
    text = whole.text
    s = study.parse_study(text + '\n[accuracy]\ntransmission_error = "3 arcsec"\n', name="x", solve=False)
    assert s.accuracy == pytest.approx({"transmission_error": 3 * arcsec})
    assert list(s.choices()) == ["transmission_error"] and s.choices()["transmission_error"].bound < 3 * arcsec
    errors = jax.jit(lambda number: sample(s.tolerances, number, seed=1))(3)
    outputs = ("transmission_error", "lost_motion")
    rough, exact = (
        jax.jit(Response.of(s.design, outputs, s.conditions, choices))(errors) for choices in (s.choices(), None)
    )
    assert rough.value["lost_motion"] == exact.value["lost_motion"]
    assert rough.value["transmission_error"].dtype == jnp.float64
    off = abs(float(rough.value["transmission_error"] - exact.value["transmission_error"]))
    assert 0 < off < 3 * arcsec
    for bad in ('noise = "1 um"', 'misfit = "1 arcsec"', 'misfit = "-1 um"', "misfit = 1"):
        with pytest.raises(study.StudyError, match="accuracy"):
            study.parse_study(f"{text}\n[accuracy]\n{bad}\n", name="x")


def test_a_chosen_level_is_the_one_that_is_computed():
    """Its settings decide over the conditions, its precision over the inputs."""
    errors = RV_20E.error_record(pin_circle_radius=9 * um, pin_radius=-3 * um, eccentricity=4 * um)
    conditions = models.kind(RV_20E).conditions()
    level = (("lost_motion_profile", "closed_form"),)
    wanted = geometric(RV_20E, errors, profile="closed_form").total
    assert abs(float(geometric(RV_20E, errors).total / wanted - 1)) > 1e-4
    for precision, bound in (("float64", 1e-14), ("float32", 1e-5)):  # of the page on stability
        chosen = {"lost_motion": levels.Choice("lost_motion", "closed form", level, precision, None, None, "asked")}
        found = Response.of(RV_20E, ("lost_motion",), conditions, chosen)(errors).value["lost_motion"]
        off = abs(float(found / wanted - 1))
        assert found.dtype == jnp.float64 and off < bound and (precision == "float64" or off > 1e-12)


def test_a_response_has_the_worst_status_of_its_outputs():
    """Whichever is asked for first: lost motion does not read the phase, the misfit does."""
    errors = RV_40E.error_record(crank_phase=np.array([0.0, np.nan]))
    conditions = models.kind(RV_40E).conditions(angles=8)
    for outputs in (("lost_motion", "misfit"), ("misfit", "lost_motion")):
        found = Response.of(RV_40E, outputs, conditions)(errors)
        assert Status(int(found.status)) == Status.NONFINITE
        assert np.isfinite(found.value["lost_motion"]) and np.isnan(found.value["misfit"])


@pytest.fixture(scope="module")
def lost_motion():
    return next(s for s in measured() if s.name == "lost_motion")


def test_measuring_a_model(lost_motion):
    ways = tuple(way for way in lost_motion.ways if way.name != "contact")
    small = dataclasses.replace(lost_motion, ways=ways, batch=64, calls=1)
    made = levels.measure_model(small, seed=0, seconds=0.01)
    exact = made.level(made.reference)
    assert exact.largest == {"lost_motion": [0.0, 0.0, 0.0]} and all(x.ns > 0 for x in made.levels)
    single = made.level("closed form, float32")
    assert 0 < made.relative(single) < 1e-5  # rounding
    assert made.relative(made.level("first order, float64")) > 100 * made.relative(single)
    assert "cycloid.pin_circle_radius" in made.design and "cranks.circle_radius" not in made.design
    assert made.errors["disc_runout"] == pytest.approx(15 * um)


@pytest.mark.long  # a model is measured above
def test_units_of_one_design_can_be_timed(lost_motion, monkeypatch):
    small = dataclasses.replace(lost_motion, ways=lost_motion.ways[:1], batch=8, calls=1, timed=32)
    given = []

    def clock(runs, **_):
        given.extend(run() for run in runs.values())
        return dict.fromkeys(runs, 32e-9)

    monkeypatch.setattr(sys.modules["rvjax.levels.measure"], "alternate", clock)
    made = levels.measure_model(small, seed=0, seconds=0.01)
    assert {level.ns for level in made.levels} == {1.0}  # of 32 units in 32 ns
    assert {len(values["lost_motion"]) for values, _ in given} == {32}
    assert made.level(made.reference).largest == {"lost_motion": [0.0, 0.0, 0.0]}


@pytest.mark.long  # test_a_study_states_its_accuracy holds one promise by default
def test_scenes_keep_their_accuracy(lost_motion):
    """40 designs and tolerances that were never measured, 32 units each."""
    kept, rng, units = lost_motion, np.random.default_rng(7), 32
    typical = stored().models["lost_motion"].typical["lost_motion"][1]

    @partial(jax.jit, static_argnums=(0, 1))
    def run(settings, precision, design, errors):
        case = jax.tree.map(lambda x: jnp.asarray(x, precision), (design, errors, jnp.zeros(units)))
        values, status = jax.vmap(lambda *c: evaluate(kept, dict(settings), *c))(*case)
        return values["lost_motion"].astype(float), status

    draw = jax.jit(jax.vmap(lambda t, k: sample(t, k, seed=5), in_axes=(None, 0)))
    names, exact = set(), (("lost_motion_profile", "contact"),)
    measured_errors = limits(kept.errors, kept.design)
    for number in range(40):
        design = jax.tree.map(lambda x: float(x * rng.uniform(0.95, 1.05)), kept.design)
        factor, accuracy = np.exp(rng.uniform(np.log(0.3), np.log(3))), typical * 10 ** rng.uniform(-4, 0)
        tolerances = measured_errors.replace(
            **{
                name: t.replace(lower=t.lower * factor, upper=t.upper * factor)
                for name, t in vars(measured_errors).items()
                if t is not None
            }
        )
        choice = chosen(accuracy, design, models.kind(RV_40E).conditions(), tolerances, "lost_motion")
        names.add(choice.level)
        errors = draw(tolerances, jnp.arange(number * units, (number + 1) * units))
        designs = jax.tree.map(lambda x: np.full(units, x), design)
        errors = jax.tree.map(lambda x: jnp.broadcast_to(x, (units,)), errors)
        true, status = run(exact, "float64", designs, errors)
        found, own = run(choice.settings, choice.precision, designs, errors)
        good = succeeded(status)
        assert jnp.all(succeeded(own)[good])
        assert jnp.all(jnp.abs(found - true)[good] <= (accuracy if choice.bound is None else choice.bound))
    assert len(names) >= 2  # the front: first order takes as long as the closed form


def test_the_command_prints_writes_and_draws(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(levels, "measure", lambda **_: Table({"cores": 2}, 0, {"m": model(ROUGH, FINE)}))
    files = tmp_path / "t.json", tmp_path / "t.png"
    assert cli.main(["tradeoff", "--full", "--json", str(files[0]), "--picture", str(files[1])]) == 0
    assert Table.load(files[0]).models["m"].level("rough") == ROUGH and files[1].stat().st_size > 1000
    assert "Take for an error below" in capsys.readouterr().out
    assert cli.main(["tradeoff", "--format", "json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(files[0].read_text())
    assert cli.main(["tradeoff", "--json", str(tmp_path / "t.txt")]) == 2
    assert "must end with .json" in capsys.readouterr().err


def test_the_table_of_levels_fits_the_terminal():
    """A row for each level, with the numbers of the table; none of them is lost in a narrow terminal."""
    table = Table({"cores": 2}, 0, {"m": model(ROUGH, FINE)})
    shown = report(SimpleNamespace(json=None, picture=None), (table, 1.0))
    rows = [" ".join(row).split() for row in levels.blocks(table)[0].rows if row[0].startswith("*")]
    assert [row[1] for row in rows] == ["rough", "fine", "exact"]
    assert [line.split() for line in shown.text().split("\n") if line.startswith("* ")] == rows
    narrow = shown.text(40)
    assert max(map(len, narrow.split("\n"))) <= 40
    assert not Counter(itertools.chain(*rows)) - Counter(narrow.split())


def test_the_level_that_the_conditions_select_is_named_with_its_measured_error():
    question = study.load("rv-40e", solve=False)
    outputs = tuple(question.requirements)
    found = levels.as_given(question.design, outputs, question.conditions, tolerances=question.tolerances)
    assert found["transmission_error"].level == "closed form, 64 angles, float64"
    largest = stored().models["transmission_error"].level(found["transmission_error"].level).largest
    bounds = SAFETY * np.array(largest["transmission_error"])
    assert bounds.min() <= found["transmission_error"].bound <= bounds.max()
    assert found["lost_motion"].bound is None and "not measured" in found["lost_motion"].why
    other = dataclasses.replace(question.conditions, angles=17)
    unknown = levels.as_given(question.design, outputs, other, tolerances=question.tolerances)["transmission_error"]
    assert unknown.bound is None and unknown.ns is None and "as in the conditions" in unknown.level
