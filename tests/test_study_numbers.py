"""Numbers of a bench against what they mean: floors of known noise, index marks, encoders, directions, lines."""

import jax
import numpy as np
import pytest

from rvjax import measured, models, study
from rvjax.measured import Conditions
from rvjax.measured.branches import branches
from rvjax.measured.cycle import Samples, _parabola
from rvjax.outputs import torque_of
from rvjax.published.rv160 import READ
from rvjax.study import bench
from rvjax.study.problem import UNMEASURED, _by_place, candidates, problem
from rvjax.units import arcsec, um

STUDY = """
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 16
closure = "first_order"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[tolerances.bearing_clearance]
lower = "4 um"
upper = "12 um"
[identify]
model = "four_bar"
orders = [40, 80]
noise = "floor"
nuisance = ["offset"]
"""


def noise_of(folder, sizes, seeds):
    """Noise of units whose curves are nothing but noise of these standard deviations, arcsec."""
    n, rows = 900, []
    for unit, (size, seed) in enumerate(zip(sizes, seeds)):
        noise = size * np.random.default_rng(seed).standard_normal(n)
        rows += [f"{k * 360 / n!r},{float(error)!r},412,forward,u{unit}" for k, error in enumerate(noise)]
    (folder / "curves.csv").write_text("\n".join(["angle [deg],error [arcsec],torque [N m],direction,unit", *rows]))
    (folder / "study.toml").write_text(STUDY)
    found = problem(study.load(folder / "study.toml", solve=False), measured.read([folder / "curves.csv"]))
    return {name: np.sqrt(np.mean(np.square(sd))) / arcsec for name, sd in found.noise.sd.items()}


def test_the_floor_of_noise_is_the_error_of_an_amplitude(tmp_path):
    """White noise of sd s in n samples gives real and imaginary parts of an order the sd s sqrt(2/n).

    The median of 20 Rayleigh amplitudes is known to 15 %, the mean square of 6 units to 6 %: two of these.
    """
    found = noise_of(tmp_path, [2.0] * 6, range(6))
    assert found["order 040"] == pytest.approx(2.0 * np.sqrt(2 / 900), rel=0.12)


def test_the_noise_of_two_units_is_the_root_of_the_mean_square(tmp_path):
    """The second unit has the same random numbers, three times as large: sqrt((1 + 9)/2) of the first floor."""
    one, both = (noise_of(tmp_path, sizes, [5, 5])["order 080"] for sizes in ([1.0], [1.0, 3.0]))
    assert both == pytest.approx(np.sqrt(5) * one, rel=1e-9)


def test_a_parabola_knows_the_spread_of_its_value():
    """4000 parabolas through six samples: the mean of their variances is the variance of their values, to 7 %."""
    rng, torque = np.random.default_rng(0), np.array([-0.9, -0.5, 0.1, 0.3, 0.6, 0.8])
    found = []
    for _ in range(4000):
        given = Samples(torque, 2 * torque + rng.standard_normal(6), np.ones(6), 0.0, 0.0, (0.0, 0.0), 1.0)
        value, share, _, spread = _parabola(given, slice(0, 6), 0.0)
        found.append((value, share * spread**2))
    values, variances = np.array(found).T
    assert np.mean(variances) == pytest.approx(np.var(values), rel=0.07)
    assert np.mean(values) == pytest.approx(0.0, abs=0.05)


def test_load_opposes_the_motion():
    runs = [Conditions(torque=100.0, direction="backward"), Conditions(torque=100.0), Conditions(direction="backward")]
    conditions = study.load("rv-40e", solve=False).conditions
    own = torque_of(conditions)
    assert bench.signed_torques(runs, conditions).tolist() == [-100.0, 100.0, -own] and own > 0


def test_an_index_mark_and_an_encoder_change_the_curve():
    """The curve is that of an angle less the mark's, plus c cos + s sin; its orders are sums over a turn."""
    question = study.load("rv-40e", solve=False)
    fields = ("crank_eccentricity", "phase", "mounting", "offset")
    model = bench.curve_model(
        "four_bar", question.design, question.conditions, [Conditions(torque=412.0)], (40, 80), fields[1:], fields
    )
    throw = np.array([[4.0, -2.0], [1.0, 3.0]]) * um
    mark, mounting = 0.01, np.array([3.0, -2.0]) * arcsec
    model = jax.jit(model)
    plain = model({"crank_eccentricity": throw, "phase": 0.0, "mounting": np.zeros(2), "offset": 0.0})
    found = model({"crank_eccentricity": throw, "phase": mark, "mounting": mounting, "offset": 5 * arcsec})
    assert found["mean"] - plain["mean"] == pytest.approx(5 * arcsec, rel=1e-9)
    angle = np.arange(512) * 2 * np.pi / 512
    value = {order: complex(plain[bench.order_name(order)][0]) for order in (40, 80)}
    assert abs(value[80]) < 0.01 * abs(value[40])  # the second wave of a crank turn is of second order in the throws
    curve = sum(np.real(v * np.exp(1j * order * (angle - mark))) for order, v in value.items())
    curve += mounting[0] * np.cos(angle) + mounting[1] * np.sin(angle)
    for order in (1, 40, 80):
        due = 2 * np.mean(curve * np.exp(-1j * order * angle))
        assert complex(found[bench.order_name(order)][0]) == pytest.approx(due, abs=1e-9 * arcsec + 1e-12 * abs(due))


def curves(runs, orders):
    question = study.load("rv-40e", solve=False)
    return bench.curve_model("four_bar", question.design, question.conditions, runs, orders, (), ())


def test_orders_too_fine_for_the_angles():
    """64 angles of a crank turn determine 31 waves of it: orders 40 to 1240."""
    assert curves([Conditions(torque=1.0)], (40 * 31,)).orders == (1240,)
    with pytest.raises(ValueError, match=r"order 1280 is crank order 32, too fine for conditions\.angles = 64"):
        curves([Conditions(torque=1.0)], (40 * 32,))


def test_no_load_lies_on_the_side_of_its_direction():
    """At a thousandth of the rated torque; drag alone takes its place."""
    runs = [Conditions(torque=0.0), Conditions(torque=0.0, direction="backward"), Conditions(torque=100.0)]
    given = models.kind(READ).conditions(rated_torque=1600.0, samples=16)
    made, dragged = (bench.curve_model("loaded", READ, given, runs, (40,), names, ()) for names in ((), ("drag",)))
    assert np.asarray(made.torques)[list(made.place)] == pytest.approx([1.6, -1.6, 100.0])
    for drag, due in ((0.0, [1.6, -1.6, 100.0]), (5.0, [5.0, -5.0, 105.0])):
        assert np.asarray(dragged._transmitted({"drag": drag}))[list(dragged.place)] == pytest.approx(due, rel=1e-12)


def test_a_planned_run_is_as_fast_as_the_fastest():
    assert bench._speeds([Conditions(speed=2.0), Conditions(speed=5.0), Conditions()]).tolist() == [2.0, 5.0, 5.0]


def test_unlike_branches_are_compared_where_both_are():
    """The falling branch ends at -60 N m: the grid does, and the width is that of the branches."""
    up, down = np.linspace(-100, 100, 400), np.linspace(100, -60, 400)
    torque = np.concatenate([up, down])
    angle = torque * 1e-6 + np.repeat([0.0, 3e-5], 400)
    found = branches("x", torque, angle)
    grid, midline, width = found.torque, found.midline, found.width
    assert -60 < grid[0] < -55 and 95 < grid[-1] < 100
    inner = grid < 90  # the turning point mixes the branches over one sample in a hundred
    assert width[inner] == pytest.approx(3e-5, rel=1e-6)
    assert midline[inner] == pytest.approx(1e-6 * grid[inner] + 1.5e-5, rel=1e-6)


def test_samples_of_a_whole_turn_stand_for_their_steps():
    """180 samples at 2 deg cover 360 deg, though the last lies 358 deg from the first."""
    run = measured.Run("a.csv", Conditions(), np.arange(180) * 2 * np.pi / 180, np.zeros(180))
    assert len(measured.checked(run, 40).angle) == 180


def test_repeated_runs_are_runs():
    run = measured.Run("a.csv", Conditions(torque=5.0), np.zeros(1), np.zeros(1))
    assert list(_by_place([run, run]).values()) == [run, run]


@pytest.mark.parametrize(
    ("planned", "sizes"), [("", [41.2, 206.0, 412.0, 824.0]), ('torques = ["206 N m", "412 N m"]', [206.0, 412.0])]
)
def test_candidates_of_the_next_run_and_their_noise(planned, sizes):
    """Shares of the largest torque or the planned ones; each is one run of its model, the only one that is measured."""
    text = STUDY.replace('"floor"', '"0.2 arcsec"').replace("[40, 80]", "[40]") + planned
    found = problem(study.parse_study(text, name="bench", solve=False))
    torques = []
    for one in candidates(found).values():
        sd = np.asarray(one.noise.sd["order 040"])
        (run,) = np.flatnonzero(sd == found.sd)
        assert len(sd) == len(found.runs) and (np.delete(sd, run) == UNMEASURED).all()
        torques.append(float(one.model.torques[one.model.place[run]]))
    assert sorted(torques) == pytest.approx(sorted([*sizes, *(-size for size in sizes)]))  # of both directions
