"""Levels of the whole machine: what may stand in for it, for which errors and loads, and what that leaves out.

Oracles: tables made by hand, whose level follows with pencil and paper; the study rv-40e-whole, whose machine and
tolerances the measured cases must be; the model itself on fresh units (`long`).
"""

import dataclasses
import math
import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from crank_turn import crank_turn

from rvjax import levels, lost_motion, models, study
from rvjax.commands import check
from rvjax.levels.choice import design_numbers, reach
from rvjax.levels.measure import evaluate, limits
from rvjax.levels.table import Level, Model, Table, stored
from rvjax.life.damage import METHODS
from rvjax.life.outputs import cases as life_cases
from rvjax.loaded.cases import MACHINE, WHOLE, cases
from rvjax.outputs import Cases, Way
from rvjax.status import succeeded
from rvjax.study.response import Response
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.units import arcsec, um

NAME, BENCH = "loaded_transmission_error", "bench_lost_motion"
GIVEN = models.kind(MACHINE).conditions(output_torque=412.0, rated_torque=412.0, samples=24, probe_angles=4)
LINKS = for_design(MACHINE, crank_eccentricity=Tolerance.symmetric(6.5 * um))
PINS = LINKS.replace(pin_radii=Tolerance.symmetric(1 * um, shape=(40,)))


def level(name, error, ns, settings, **more):
    return Level(name, settings, "float64", {NAME: [error] * 2}, {NAME: [error] * 2}, ns, 1.0, 1.0, 10, **more)


def family(name, errors, others, *made):
    exact = level("exact", 0.0, 100.0, dict(pin_contact="hertz", samples=96))
    return Model(
        name=name, outputs={NAME: "rad"}, case="case", design=design_numbers(MACHINE), spread=0.05, errors=errors,
        sizes=[0.3, 3.0], torque=(41.2, 412.0), conditions=dict(sun="fixed"), typical={NAME: [1.0] * 2}, failed=(0, 1),
        reference="exact", levels=(*made, exact), question=dict(span="crank_turn"), others=others,
    )  # fmt: skip


LINKAGE = level(
    "four-bar", 2 * arcsec, 1.0, dict(angles=16), instead={NAME: "transmission_error"}, without="pins and flanks"
)
LINEAR = level("linear", 3 * arcsec, 10.0, dict(pin_contact="linear", samples=12), without="the flattening of pins")
CRANKS = {"crank_eccentricity": 6.5 * um}
MADE = Table({}, 0, {
    "whole": family("whole", CRANKS | {"pin_radii": 1 * um}, ("eccentricity", "contact.pin_support"), LINEAR),
    "links": family("links", CRANKS, ("pin_radii", "eccentricity", "contact.pin_support"), LINKAGE),
})  # fmt: skip


def chosen(tolerances=LINKS, accuracy=10 * arcsec, design=MACHINE, given=GIVEN, table=MADE, name=NAME):
    return levels.choose(design, (name,), given, tolerances=tolerances, accuracy={name: accuracy}, table=table)[name]


def test_another_model_stands_in_for_its_own_errors_alone():
    alone, whole = chosen(), chosen(PINS)
    assert (alone.level, alone.instead, alone.without) == ("four-bar", "transmission_error", "pins and flanks")
    assert "not modelled: pins and flanks" in alone.why and alone.bound == pytest.approx(4 * arcsec)
    assert (whole.level, whole.instead) == ("linear", None) and "the flattening of pins" in whole.why
    assert chosen(PINS, 5 * arcsec).level == "exact"  # twice 3 arcsec is more
    assert chosen(accuracy=3 * arcsec).level == "exact"


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (dict(tolerances=LINKS.replace(eccentricity=Tolerance.symmetric(1 * um))), "eccentricity, which no case had"),
        (
            dict(tolerances=for_design(MACHINE, crank_eccentricity=Tolerance.symmetric(60 * um))),
            "crank_eccentricity of",
        ),
        (dict(design=MACHINE.replace(contact=MACHINE.contact.replace(pin_support=1e8))), "contact.pin_support"),
        (dict(given=dataclasses.replace(GIVEN, output_torque=20.0)), "torque = 20"),
        (dict(given=dataclasses.replace(GIVEN, sun="floating")), "sun = 'floating'"),
    ],
)
def test_outside_what_was_measured_the_exact_level(change, word):
    choice = chosen(**change)
    assert choice.level == "exact" and choice.bound is None and word in choice.why and not choice.without


def test_the_exact_level_takes_no_fewer_angles_than_asked():
    for samples, taken in ((24, 96), (200, 200)):
        given = dataclasses.replace(GIVEN, samples=samples, output_torque=20.0)
        assert dict(chosen(given=given).settings)["samples"] == taken
    measured = chosen(PINS, 1e-9, given=dataclasses.replace(GIVEN, samples=200))
    assert dict(measured.settings)["samples"] == 96  # the accuracy decides


def test_another_span_is_another_question():
    """96 angles of a crank turn are exact, of an output turn of forty they are nothing."""
    choice = chosen(given=dataclasses.replace(GIVEN, span="output_turn", samples=4000))
    assert choice.settings == () and choice.bound is None and "as the conditions define" in choice.why


def test_cases_are_the_study_of_the_whole_machine():
    question = study.load("rv-40e-whole", solve=False)
    whole = question.design.replace(bearings=None)  # which no measured output reads
    assert design_numbers(MACHINE) == pytest.approx(design_numbers(whole))
    measured, asked = (reach(tolerances) for tolerances in (limits(WHOLE, MACHINE), question.tolerances))
    assert measured == pytest.approx(asked)
    for name in measured:
        mine, theirs = getattr(limits(WHOLE, MACHINE), name), getattr(question.tolerances, name)
        assert type(mine.law) is type(theirs.law) and (mine.batch, mine.shape) == (theirs.batch, theirs.shape)


def test_each_method_of_the_life_is_a_question_of_its_own():
    """No level changes the method, whose lives differ by design; places of bearings are numbers of the design."""
    areas = {area.question["life_method"]: area for area in life_cases(False)}
    assert tuple(areas) == METHODS
    for method, area in areas.items():
        assert all(set(way.settings) == {"life_samples"} and way.name.startswith(method) for way in area.ways)
        samples = [way.settings["life_samples"] for way in area.ways]
        assert samples == sorted(samples)  # the last one is the reference
    numbers = design_numbers(next(iter(areas.values())).design)
    assert [numbers[f"bearings.disc_position[{k}]"] for k in range(2)] == pytest.approx([0.014, 0.026])


def test_a_table_of_a_condition_is_read_as_it_was_measured(tmp_path):
    made = stored()
    duty = ((412.0, 1.5, 3600.0),)
    model = dataclasses.replace(made.models["loaded_bench"], conditions={"duty": duty, "carrier": "fixed"})
    dataclasses.replace(made, models={"x": model}).save(tmp_path / "table.json")
    read = type(made).load(tmp_path / "table.json").models["x"]
    assert read.conditions == {"duty": duty, "carrier": "fixed"}


def test_a_level_of_another_model_is_computed_by_it():
    """By the question as by the measurement; what it does not know has no value."""
    bench = dataclasses.replace(next(c for c in cases(False) if BENCH in c.outputs), outputs={BENCH: "rad", "b": "m"})
    way = next(way for way in bench.ways if way.instead)
    choice = levels.Choice(BENCH, way.name, tuple(way.settings.items()), "float64", None, None, "", way.instead[BENCH])

    @jax.jit
    def asked(errors):
        response = Response.of(MACHINE, (BENCH,), GIVEN, {BENCH: choice}, bench.bounds)(errors)
        return evaluate(bench, way.settings, MACHINE, errors, 0.0, way.instead), response.value[BENCH]

    errors = MACHINE.error_record(disc_centre=np.array([[3 * um, 4 * um], [0, 0]]), pin_radius=-3 * um)
    (values, status), response = asked(errors)
    own = lost_motion.geometric(MACHINE, errors.bounded(bench.bounds)).total
    without = lost_motion.geometric(MACHINE, errors).total
    assert set(values) == {BENCH, "b"} and succeeded(status) and np.isnan(values["b"])
    assert values[BENCH] == response == pytest.approx(float(own), rel=1e-12) and abs(own / without - 1) > 1e-3


def test_what_has_no_value_is_never_taken():
    def half(settings, design, errors, extra):
        value = extra * (1.0 + 0.1 * settings["rough"])
        return {"a": value, "b": jnp.where(settings["rough"] > 0, jnp.nan, value)}, jnp.int32(0)

    ways = tuple(Way(name, dict(rough=rough), ("float64",)) for name, rough in (("rough", 1.0), ("fine", 0.0)))
    made = levels.measure_model(
        Cases("m", "case", dict(a="m", b="m"), MACHINE, None, {}, None, ways, 4, 2, evaluate=half,
              extra=lambda rng, count, size: rng.uniform(1, 2, count)),
        seed=0, seconds=0.001,
    )  # fmt: skip
    rough = made.level("rough, float64")
    assert made.drawn == 8 and 0.1 <= rough.largest["a"][1] <= 0.2 and rough.largest["b"] == [math.inf] * 3
    assert made.cheapest({"b": 1.0}, 1.0).name == "fine, float64"


def test_a_study_of_lives_finds_the_levels_of_its_method():
    """Its duty is the measured one to the digits of the file. Smaller errors have a bound; another duty has none."""
    question = study.load("rv-40e-whole", solve=False)
    small = for_design(MACHINE, crank_eccentricity=Tolerance.symmetric(3 * um))
    given = levels.as_given(question.design, ("life",), question.conditions, tolerances=small)["life"]
    assert given.level.startswith("basic, 12 angles") and 0 < given.bound < 1000 * 3600
    speed = dataclasses.replace(question.conditions, duty=((412.0, 2.0, 3600.0),))
    assert levels.as_given(question.design, ("life",), speed, tolerances=small)["life"].bound is None
    own = levels.as_given(question.design, ("life",), question.conditions, tolerances=question.tolerances)["life"]
    assert own.bound is None and "failed" in own.why  # at three times its errors a unit has a life only with 96 angles


FAMILIES = [name for name in stored().models if name.startswith("loaded")]


def test_the_stored_table_knows_the_whole_machine():
    assert {"loaded_turn", "loaded_linkage", "loaded_bench"} <= set(FAMILIES)
    question = crank_turn("rv-40e-whole", 24)
    given = levels.as_given(question.design, (NAME, BENCH), question.conditions, tolerances=question.tolerances)
    assert given[NAME].level.startswith("hertz, 24 angles") and 0 < given[NAME].bound < 60 * arcsec
    table = stored()
    for name in FAMILIES:
        made = table.models[name]
        assert made.drawn >= 128 and made.sizes == [0.3, 1.0, 3.0] and made.failed[0] < 0.02 * made.failed[1]
    for tolerances, accuracy in ((question.tolerances, 90 * arcsec), (LINKS, 90 * arcsec)):
        rough = chosen(tolerances, accuracy, table=table)
        assert rough.bound <= accuracy and rough.without and rough.ns < given[NAME].ns
    assert chosen(question.tolerances, 1e-3 * arcsec, table=table).bound is None


def test_a_study_says_what_its_level_leaves_out():
    """Where its costs let no tolerance become wider than what was measured; else the exact level."""
    wide = crank_turn("rv-40e-whole", 24).text + '\n[accuracy]\nloaded_transmission_error = "90 arcsec"\n'
    narrow = re.sub(r'coarsest = "(\d\d) (um|arcmin)"', r'coarsest = "5 \2"', wide)
    for text, words in (
        (wide, "outside the measured range (crank_eccentricity of"),
        (narrow, "error below 1.5 arcmin; not modelled"),
    ):
        asked = study.parse_study(text, name="x", solve=False)
        assert words in next(line for line in check.level_lines(asked) if line.startswith(NAME))


def test_responses_of_one_level_share_a_line():
    drive = study.load("cycloidal-17", solve=False)
    (line,) = check.level_lines(drive)
    assert line.startswith(f"{', '.join(drive.requirements)}: as in the conditions (") and "accuracy" not in line
    limited = dataclasses.replace(drive, accuracy={"turn_pin_pressure": 1e6})
    (_, ignored) = check.level_lines(limited)
    assert ignored.startswith("turn_pin_pressure: ") and "accuracy ignored" in ignored


@pytest.mark.long
@pytest.mark.parametrize("accuracy", [90.0, 30.0, 8.0])
def test_fresh_units_keep_the_accuracy(accuracy):
    question = study.load("rv-40e-whole", solve=False)
    choice = chosen(question.tolerances, accuracy * arcsec, table=stored())
    units = jax.vmap(lambda k: sample(question.tolerances, k, seed=77))(jnp.arange(128))
    rough, exact = (
        jax.jit(jax.vmap(Response.of(question.design, (NAME,), given, picked)))(units)
        for given, picked in ((GIVEN, {NAME: choice}), (dataclasses.replace(GIVEN, samples=192), None))
    )
    assert succeeded(exact.status).all()
    assert jnp.max(jnp.abs(rough.value[NAME] - exact.value[NAME])) < accuracy * arcsec
