"""Measured loops against what they were made of: a play operator, a spring and a backlash, cycled in every order.

Oracle: the closed forms of `lost_motion.loop_figures` and the two branches g(T -+ friction) of the closed loop.
"""

from itertools import pairwise

import numpy as np
import pytest

from rvjax import measured, plotting
from rvjax.lost_motion import loop_figures
from rvjax.measured import KINDS
from rvjax.measured.reversals import cycles
from rvjax.units import arcmin

FRICTION, STIFFNESS, PLAY, CLOSES, MOST = 20.0, 108.0, 0.4, 10.0, 412.0  # N m, N m/arcmin, arcmin, N m, N m
EXACT = loop_figures(
    torque_threshold=0.03 * MOST,
    torque_max=MOST,
    play=PLAY * arcmin,
    stiffness=STIFFNESS / arcmin,
    friction=FRICTION,
    smoothing=CLOSES,
)
THREE = (0, MOST, -MOST, MOST)


def springs(passed):
    """Angle under the torque that reaches the springs, arcmin."""
    return passed / STIFFNESS + PLAY / 2 * np.tanh(passed / CLOSES)


def ramp(*ends, step=2.01):
    parts = [np.linspace(a, b, int(np.ceil(abs(b - a) / step)) + 1)[1:] for a, b in pairwise(ends)]
    return np.concatenate([[float(ends[0])], *parts])


def twist(torque, passed=0.0, friction=FRICTION):
    """Angle as the torque runs, arcmin; `passed` reaches the springs before."""
    angles = []
    for now in torque:
        passed = max(now - friction, min(now + friction, passed))
        angles.append(springs(passed))
    return np.array(angles)


@pytest.fixture
def read(tmp_path):
    def made(torque, angle):
        path = tmp_path / "loop.csv"
        rows = "".join(f"{float(t)!r},{float(a)!r}\n" for t, a in zip(torque, angle))
        path.write_text("torque [N m],angle [arcmin]\n" + rows)
        (loop,) = measured.read([path]).items
        return loop, {finding.name: finding for finding in KINDS["loop"].findings(loop, {})}

    return made


def score(loop):
    """Midline less its exact value over the stated standard deviation, then the width."""
    rising, falling = springs(loop.torque - FRICTION), springs(loop.torque + FRICTION)
    sd = loop.sd / arcmin
    midline = (loop.midline / arcmin - (rising + falling) / 2) / sd
    return np.concatenate([midline, (loop.width / arcmin - (falling - rising)) / (2 * sd)])


def test_a_bench_in_three_stages(read):
    """A file of two and five decimals, as a bench writes it; the samples are 2 N m apart, the play closes over 10."""
    torque = ramp(*THREE)
    loop, found = read(np.round(torque, 2), np.round(twist(torque), 5))
    assert np.interp(0.0, loop.torque, loop.midline) == pytest.approx(0.0, abs=2e-4 * arcmin)
    assert found["width at zero torque"].value == pytest.approx(float(EXACT.zero_torque_width), abs=2e-4 * arcmin)
    assert found["lost motion"].value == pytest.approx(float(EXACT.lost_motion), abs=2e-4 * arcmin)
    assert found["stiffness"].value == pytest.approx(STIFFNESS / arcmin, rel=1e-5)
    assert found["energy"].value == pytest.approx(float(EXACT.energy), rel=1e-4)
    assert "3 % of the extreme torque" in found["lost motion"].text and "12.36 N m" in found["lost motion"].text
    assert np.abs(score(loop)).max() < 3
    assert np.median(loop.sd) < 1e-4 * arcmin and loop.sd.max() < 1e-3 * arcmin
    assert not any(finding.warning for finding in found.values())


def test_the_branches_part_where_friction_has_reversed(read):
    """2 x 20 N m behind a reversal; before, the falling branch rests and the midline is no spring's."""
    torque = ramp(*THREE)
    loop, found = read(torque, twist(torque))
    assert found["reversal of the friction"].value == pytest.approx(2 * FRICTION, abs=4)
    half = np.diff(loop.torque)[0] / 2
    assert loop.torque[-1] + half == pytest.approx(MOST - 2 * FRICTION, abs=4)


def test_the_first_branch_is_no_part_of_a_loop(read):
    """It is bent by 5 arcmin here: nothing of the loop changes."""
    torque = ramp(*THREE)
    angle = twist(torque)
    first = np.arange(len(torque)) < np.argmax(torque) - 20
    plain, _ = read(torque, angle)
    bent, _ = read(torque, angle + np.where(first, 5 * np.sin(torque / 50), 0.0))
    np.testing.assert_array_equal(bent.midline, plain.midline)
    assert np.all(plain.recorded.branch[: np.argmax(torque)] == 0)
    fall = slice(np.argmax(torque) + 1, np.argmin(torque))
    assert np.all(plain.recorded.branch[fall] == -1)
    assert np.mean(plain.recorded.branch[np.argmin(torque) + 1 :] == 1) > 0.99


@pytest.mark.parametrize(
    ("ends", "passed", "whole", "text"),
    [
        pytest.param((0, -MOST, MOST, -MOST), 0.0, 1, "one whole cycle", marks=pytest.mark.long),
        ((MOST, -MOST, MOST), MOST - FRICTION, 1, "one whole cycle"),
        ((0, MOST, -MOST, MOST, -MOST, MOST), 0.0, 2, "mean of the last 2 of 2"),
        ((0, MOST, -MOST, 0), -FRICTION, 1, "ends on the branch on which it starts"),
        pytest.param(
            (0, 60, -60, 60, MOST, -MOST, MOST, 0, 60, -60), 0.0, 1, "one whole cycle", marks=pytest.mark.long
        ),
        ((0, MOST, -MOST, MOST, 300, 350, -MOST), 0.0, 1, "one whole cycle"),
    ],
)
def test_cycles_in_any_order(read, ends, passed, whole, text):
    torque = ramp(*ends)
    loop, found = read(torque, twist(torque, passed))
    assert found["cycles"].value == whole and text in found["cycles"].text
    assert found["width at zero torque"].value == pytest.approx(float(EXACT.zero_torque_width), abs=5e-4 * arcmin)
    assert found["lost motion"].value == pytest.approx(float(EXACT.lost_motion), abs=5e-4 * arcmin)
    assert found["stiffness"].value == pytest.approx(STIFFNESS / arcmin, rel=1e-4)
    assert np.abs(score(loop)).max() < 3


@pytest.mark.parametrize("last", [(), (60, -60) * 3])
def test_of_several_amplitudes_the_largest_is_read(read, last):
    torque = ramp(0, *(60, -60) * 3, *(MOST, -MOST) * 2, MOST, *last)
    loop, found = read(torque, twist(torque))
    assert loop.torque[-1] > 350 and np.abs(score(loop)).max() < 3
    assert "-60 to 60 N m" in found["other cycles"].text and found["other cycles"].value == 1
    assert found["cycles"].text.startswith("mean of the last 2 of 2")


def test_cycles_that_agree_are_averaged(read):
    """Four cycles with noise: half the standard deviation of one. A shift between them: the last one only."""
    torque = ramp(0, *(MOST, -MOST) * 4, MOST)
    angle = twist(torque) + 0.02 * np.random.default_rng(0).standard_normal(len(torque))
    last = len(torque) - len(ramp(MOST, -MOST, MOST)) - 20
    one, _ = read(torque[last:], angle[last:])
    four, found = read(torque, angle)
    assert found["cycles"].value == 4
    assert np.median(four.sd) == pytest.approx(np.median(one.sd) / 2, rel=0.15)
    moved, found = read(torque, angle + np.where(np.arange(len(torque)) < last - 100, 0.1, 0.0))
    assert found["cycles"].value == 1 and found["cycles"].text.startswith("the last of 4 whole cycles")
    assert np.abs(score(moved)).max() < 4


def test_cycles_of_few_samples_are_read_together(read):
    """Twenty-one samples on each branch, at other torques in each of eight cycles."""
    torque, rng = ramp(0, *(MOST, -MOST) * 8, MOST, step=40), np.random.default_rng(0)
    torque = torque + np.where(np.abs(torque) < 390, rng.uniform(-13, 13, len(torque)), 0.0)
    angle = twist(torque) + 0.01 * rng.standard_normal(len(torque))
    loop, found = read(torque, angle)
    assert found["cycles"].value == 8 and "8 whole cycles as one" in found["cycles"].text
    two, _ = read(torque[-90:], angle[-90:])
    assert np.median(loop.sd) == pytest.approx(np.median(two.sd) / 2, rel=0.3)
    assert np.sqrt(np.mean(score(loop) ** 2)) < 1.5 and np.median(loop.sd) < 0.006 * arcmin


def test_an_open_loop_says_its_gap(read):
    """Creep of 0.3 arcmin in the record: the cycle is four fifths of it; its gap is half of the width's sd."""
    torque = ramp(*THREE)
    time = np.arange(len(torque)) / (len(torque) - 1)
    loop, found = read(torque, twist(torque) + 0.3 * time)
    gap, cycle = found["closure gap"], 2 * MOST * 2 / (5 * MOST)
    assert gap.value == pytest.approx(0.3 * cycle * arcmin, rel=1e-3)
    assert gap.warning and "0.24 arcmin" in gap.text
    np.testing.assert_allclose(loop.sd, gap.value / 2, rtol=0.01)
    rising, falling = springs(loop.torque - FRICTION), springs(loop.torque + FRICTION)
    np.testing.assert_allclose(loop.width / arcmin, falling - rising, atol=5e-4)
    shift = loop.midline / arcmin - (rising + falling) / 2
    np.testing.assert_allclose(shift, 0.3 * 3 / 5, atol=2e-3)  # creep of the time when the torque reverses
    assert found["stiffness"].value == pytest.approx(STIFFNESS / arcmin, rel=1e-4)
    assert not read(torque, twist(torque))[1]["closure gap"].warning


def test_a_loop_on_one_side_has_no_width_across_zero(read):
    torque = ramp(0, MOST, 0, MOST, 0)
    loop, found = read(torque, twist(torque))
    assert found["one-sided loop"].warning
    assert "width at zero torque" not in found and "lost motion" not in found
    assert loop.torque[0] > 2 * FRICTION and np.abs(score(loop)).max() < 3
    assert found["stiffness"].value == pytest.approx(STIFFNESS / arcmin, rel=1e-4)
    once = ramp(0, MOST, 0)
    with pytest.raises(ValueError, match="the first branch is no part of a loop"):
        read(once, twist(once))


def test_two_branches_without_a_whole_cycle(read):
    """0, +, -, 0: the rising branch ends at zero, and so does the loop."""
    torque = ramp(0, MOST, -MOST, 0)
    loop, found = read(torque, twist(torque))
    assert found["cycles"].warning and "no whole cycle" in found["cycles"].text
    assert -366 < loop.torque[0] < -355 and -15 < loop.torque[-1] < 0 and np.abs(score(loop)).max() < 3
    assert found["width at zero torque"].value == pytest.approx(float(EXACT.zero_torque_width), abs=3e-3 * arcmin)
    assert "lost motion" not in found and "closure gap" not in found


def test_a_sensor_at_its_end_and_a_torque_at_rest(read):
    """Both stay at the extreme: the angle goes on, or it does not. At rest in between, nothing changes."""
    torque = ramp(*THREE)
    loop, found = read(np.clip(torque, -330, 330), twist(torque))
    assert loop.clipped and found["clipped sensor"].warning and "energy" not in found
    assert loop.torque[-1] < 330 and np.abs(score(loop)).max() < 3
    rests = np.ones(len(torque), int)
    rests[(np.abs(torque) == MOST) | (np.abs(np.abs(torque) - 100) < 1)] = 60
    held = np.repeat(torque, rests)
    loop, found = read(held, twist(held))
    assert not loop.clipped and "clipped sensor" not in found
    assert np.abs(score(loop)).max() < 3
    assert found["width at zero torque"].value == pytest.approx(float(EXACT.zero_torque_width), abs=5e-4 * arcmin)


def made_of_noise(kind, rng):
    if kind == "angle":
        torque = ramp(*THREE)
        return torque, twist(torque) + 0.02 * rng.standard_normal(len(torque))
    if kind == "torque":
        torque = ramp(*THREE, step=1.0)
        angle = twist(torque) + 0.01 * rng.standard_normal(len(torque))
        return torque + 4 * rng.standard_normal(len(torque)), angle
    torque = ramp(*THREE, step=1.0) + rng.uniform()
    angle = twist(torque) + 0.01 * rng.standard_normal(len(torque))
    return np.round(torque / 2) * 2, np.round(angle / 0.05) * 0.05


@pytest.mark.parametrize("kind", ["torque", *(pytest.param(k, marks=pytest.mark.long) for k in ("angle", "steps"))])
def test_the_stated_spread_covers_the_truth(read, kind):
    """Eight benches of 42 numbers: 95 % lie within two standard deviations, as they would of a normal distribution.

    The torque of the second has noise of 1 % of its amplitude on steps of 1 N m; the third reads torque and angle
    in steps of 2 N m and 0.05 arcmin.
    """
    loops = [read(*made_of_noise(kind, np.random.default_rng(seed))) for seed in range(8)]
    scores = np.concatenate([score(loop) for loop, _ in loops])
    assert all(len(loop.torque) == 21 for loop, _ in loops)
    assert 0.92 < np.mean(np.abs(scores) < 2) < 0.995
    assert 0.7 < np.sqrt(np.mean(scores**2)) < 1.2


def test_a_restart_of_the_record_is_found(read):
    """Each loop starts at rest and at angle zero, as a bench writes them one after the other."""
    torque, step = ramp(0, MOST, -MOST, 0), len(ramp(0, MOST, -MOST, 0))
    angle = twist(torque)
    loop, found = read(np.tile(torque, 3), np.tile(angle, 3))
    restart = found["restart"]
    assert restart.warning and f"row {2 * step + 1}, {step + 1}" in restart.text
    lost = loop.recorded.branch[2 * step : 2 * step + 15]
    assert np.all(lost == 0) and loop.recorded.branch[2 * step - 5] == 1
    assert np.abs(score(loop)).max() < 3
    part, found = read(np.tile(torque, 2), np.concatenate([angle, angle + 3]))  # another zero: no cycle of two parts
    assert "no whole cycle" in found["cycles"].text and part.torque[-1] < 0


def test_reversals_beside_a_noisy_torque():
    """A torque with noise of a tenth of its amplitude: every reversal is found once, within a few samples."""
    command = ramp(0, *(4, -4) * 5, 0, step=0.05)
    torque = command + 0.4 * np.random.default_rng(0).standard_normal(len(command))
    found = cycles(torque)
    assert found.noise == pytest.approx(0.4, rel=0.1) and len(found.used) == 4
    for cycle in found.used:
        for turn in cycle.span:
            assert abs(abs(command[turn]) - 4) < 1


def test_the_plot_of_a_loop_shows_which_samples_are_read(read):
    torque = ramp(*THREE)
    loop, found = read(torque, twist(torque))
    kept = loop.recorded
    axes = plotting.measured_loop(
        *(loop.torque, loop.midline, loop.width, loop.midline),
        recorded=(kept.torque, kept.angle, kept.branch),
    )
    drawn = {line.get_label(): line.get_xydata() for line in axes.get_lines()}
    for name, branch in (("rising", 1), ("falling", -1), ("not used", 0)):
        own = kept.branch == branch
        np.testing.assert_allclose(drawn[name], np.stack([torque[own], kept.angle[own] / arcmin], axis=1))
    (width,) = (points for name, points in drawn.items() if "at zero torque" in name)
    assert np.diff(width[:, 1]) * arcmin == pytest.approx(found["width at zero torque"].value, rel=1e-3)


def test_a_staircase_of_torques_is_read(read):
    """Five readings at each of 83 torques of a branch, 10 N m apart: equal torques are one sample."""
    torque = np.repeat(ramp(*THREE, step=10.0), 5)
    angle = twist(torque) + 0.005 * np.random.default_rng(0).standard_normal(len(torque))
    loop, found = read(torque, angle)
    assert not loop.clipped and len(loop.torque) == 21
    assert np.sqrt(np.mean(score(loop) ** 2)) < 1.2
    assert found["stiffness"].value == pytest.approx(STIFFNESS / arcmin, rel=2e-3)


@pytest.mark.parametrize("step", [41.2, 20.6])
@pytest.mark.parametrize("again", [1, 4])
def test_a_cycle_of_few_torques_is_refused_however_long_the_record(read, step, again):
    """The backlash closes over 10 N m: 20 or 40 torques of a branch give a width of 0.56 for 0.756 arcmin."""
    torque = np.repeat(ramp(0, *(MOST, -MOST) * 2, MOST, step=step), again)
    with pytest.raises(ValueError, match=r"torques in a cycle, both ways: needs 84; take smaller steps"):
        read(torque, twist(torque))


def test_steps_beyond_the_torque_of_lost_motion_give_no_width(read):
    """Enough torques, in steps of 19 N m about zero; fine steps there and coarse ones outside are enough."""
    torque = ramp(*THREE, step=19.0)
    loop, found = read(torque, twist(torque))
    assert found["coarse steps"].warning and found["coarse steps"].value == pytest.approx(18.7, abs=0.1)
    assert "width at zero torque" not in found and "lost motion" not in found
    assert np.abs(score(loop)).max() < 3
    half = np.r_[np.linspace(0, 20, 11), np.linspace(30, MOST, 35)]
    cycle = np.r_[-half[::-1], half[1:]]
    torque = np.r_[half, cycle[::-1][1:], cycle[1:]]
    _, found = read(torque, twist(torque))
    assert "coarse steps" not in found
    assert found["lost motion"].value == pytest.approx(float(EXACT.lost_motion), abs=1e-3 * arcmin)
