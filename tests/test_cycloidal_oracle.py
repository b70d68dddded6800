"""The independent model of the single-stage drive: reference cases, closed forms, invariants of the energy."""

import copy

import numpy as np
import pytest
from cycloidal_cases import CASES, NAMED, dictionaries

from rvjax import catalogue
from tests.oracles import cycloidal as oracle

SOLVED = [case for case in CASES if case["kind"] == "equilibrium" and len(case["expect"]) > 1]
ARCMIN = np.pi / 180 / 60


@pytest.mark.parametrize("case", SOLVED, ids=[case["name"] for case in SOLVED])
def test_the_oracle_gives_the_reference(case):
    due, found = case["expect"], oracle.equilibrium(case["design"], case["errors"], **case["options"])
    assert found["status"] == due["status"]
    loaded = due["status"] == "CONVERGED"
    assert found["error"] == pytest.approx(due["error"], rel=1e-9, abs=1e-14 if loaded else 1e-11)
    largest = max(np.max(due["pins"]), np.max(due["output_pins"]))
    for name in ("pins", "output_pins", "disc_bearing", "support_bearing", "output_bearing"):
        np.testing.assert_allclose(found[name], due[name], rtol=0, atol=1e-8 * largest + 1e-8, err_msg=name)
    lever = np.max(np.abs(due["pins"])) * case["design"]["cycloid"]["pin_circle_radius"]
    np.testing.assert_allclose(found["disc_torque"], due["disc_torque"], rtol=0, atol=1e-8 * lever + 1e-12)
    assert found["stiffness"] == pytest.approx(due["stiffness"], rel=1e-6)
    for name, most in (("pressure", "largest_pressure"), ("output_pressure", "largest_output_pressure")):
        assert found[name].max() == pytest.approx(due[most], rel=1e-7)


@pytest.mark.parametrize("name", ["c17: fit, errors", "ring13: fit, errors"])
def test_the_fit_of_the_oracle_is_that_of_the_reference(name):
    case = NAMED[name]
    design, n = case["design"], case["options"]["samples"]
    zc = design["cycloid"]["disc_teeth"]
    ratio = -zc if design["member"] == "carrier" else zc + 1
    at = [oracle.fit(design, case["errors"], 2 * np.pi * ratio / (zc + 1) * j / n) for j in range(n)]
    np.testing.assert_allclose(at, case["expect"]["at"], rtol=1e-9, atol=1e-13)


def v17(bearing=30e6, flank=0.0, hole=0.0, discs=1, n=6, member="carrier", support=None):
    """17 lobes, linear springs; clearance of the flank and radial clearance of the holes."""
    return {
        "member": member,
        "cycloid": {
            "disc_teeth": 17, "pin_count": 18, "disc_count": discs, "eccentricity": 1.3e-3, "shift_modification": 0.0,
            "pin_circle_radius": 42.5e-3, "pin_radius": 2.5e-3, "equidistant_modification": flank,
        },
        "output": {
            "count": n, "circle_radius": 32.9e-3, "pin_radius": 2.5e-3, "hole_clearance": 2 * hole,
            "pin_stiffness": 60e6, "pin_support": None,
        },
        "stiffness": {"eccentric_bearing": bearing, "shaft_support": support, "output_support": 0.0},
        "contact": {
            "young_modulus": 206e9, "poisson_ratio": 0.3, "face_width": 0.01, "pin_stiffness": 40e6,
            "pin_support": None,
        },
    }  # fmt: skip


def solve(design, torque=-5.85, angle=0.1, contact="linear", **errors):
    return oracle.equilibrium(design, errors, input_angle=angle, output_torque=torque, contact=contact)


C, E = {"flank": 10e-6, "hole": 25e-6}, {"flank": -5e-6, "hole": -5e-6}
TABLE = {  # error, beta arcmin; disc along u, J u um; largest pin, hole N (and its pin); bearing along u, J u N
    "A": (v17(1e10), -5.85, 0, 0.440143, 0.231816, -0.0148, -0.0265, 58.4779, 9, 108.4496, 3, 148.1147, 264.7049),
    "B": (v17(), -5.85, 0, 1.862193, 1.580241, -0.6119, -8.8235, 58.2535, 11, 111.2679, 2, 18.3559, 264.7059),
    "B, +": (v17(), 5.85, 0, -1.861251, -1.578970, -0.6146, 8.8235, 58.4955, 10, 111.2773, 2, 18.4376, -264.7059),
    "C": (v17(**C), -5.85, 10e-6, 8.458174, 4.651961, -5.0520, -18.4692, 95.6662, 5, 194.5384, 1, 72.4065, 264.7058),
    "C, +": (
        v17(**C), 5.85, 10e-6, -8.457938, -4.676904, -4.8317, 18.4989, 100.8082, 5, 194.5384, 1, 69.1384, -264.7058,
    ),
    "E": (v17(**E), -5.85, 0, 1.590133, 1.486912, -1.0217, -8.8235, 250.0833, 18, 292.8725, 6, 30.6509, 264.7059),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLE)
def test_the_table_of_one_disc(name):
    design, torque, bearing, error, beta, *rest = TABLE[name]
    found = solve(design, torque, bearing_clearance=bearing)
    x, y, turn = found["position"][:3]
    b = 18 / 17 * 0.1
    along = np.array([[np.cos(b), np.sin(b)], [-np.sin(b), np.cos(b)]])
    assert found["error"] / ARCMIN == pytest.approx(error, abs=1e-6) and turn / ARCMIN == pytest.approx(beta, abs=1e-6)
    pins, holes = found["pins"][0], found["output_pins"][0]
    own = [*along @ [x, y] * 1e6, pins.max(), np.sum(pins > 0), holes.max(), np.sum(holes > 0)]
    np.testing.assert_allclose([*own, *along @ found["disc_bearing"][0, 0]], rest, rtol=0, atol=6e-5)


FREE = {(10, 0, 0): 3.1368, (0, 0, 25): 5.6641, (10, 10, 25): 12.3116, (20, 10, 25): 15.5348}
"""Backlash, arcmin, of a scan of all positions: clearance of flank, bearing and holes (radial), um."""


@pytest.mark.parametrize("clearances", FREE)
def test_the_backlash_is_that_of_a_scan_of_all_positions(clearances):
    """At a torque too small for deflections, too large for centring springs; the closed form has pins everywhere."""
    flank, bearing, hole = (1e-6 * each for each in clearances)
    design, b = v17(1e8, flank=flank, hole=hole), 0.12 * 18 / 17
    minus, plus = (solve(design, torque, 0.12, bearing_clearance=bearing)["error"] for torque in (-1e-3, 1e-3))
    assert (minus - plus) / ARCMIN == pytest.approx(FREE[clearances], rel=1e-3)
    s = np.linspace(0, min(bearing, flank), 2001)
    most = np.max(np.abs(np.sin(b - 2 * np.pi * np.arange(6) / 6)))
    turned = (np.sqrt(bearing**2 - s**2) + np.sqrt(flank**2 - s**2)) / (1.3e-3 * 17)
    assert minus - plus == pytest.approx(2 * np.max(turned + (hole + s) / (most * 32.9e-3)), rel=1e-2)


KNOWN = {  # torque; backlash arcmin, stiffness N m/arcmin, largest pin and hole N, pressure MPa, eccentric N
    "15": (5.0, 103.348, 1.1465, 104.28, 83.33, 63.3, 37.0, 141.5),
    "17": (8.8, 23.916, 6.4845, 163.66, 136.22, 490.6, 249.6, 223.0),
    "29": (116.0, 2.984, 118.91, 378.89, 1977.1, 835.9, 390.7, 1855.1),
}


@pytest.mark.parametrize("lobes", [pytest.param(n, marks=[] if n == "17" else [pytest.mark.long]) for n in KNOWN])
def test_the_known_drives(lobes):
    """Without errors: 12 angles over a crank turn for the largest values, input angle 0 for the others."""
    torque, *due = KNOWN[lobes]
    design, zc = dictionaries(getattr(catalogue, f"CYCLOIDAL_{lobes}")), int(lobes)
    error = {share: solve(design, share * torque, 0.0, "hertz")["error"] for share in (-1e-3, 1e-3, 0.5, 1.0)}
    angles = -zc * 2 * np.pi / (zc + 1) * np.arange(12) / 12
    found = [solve(design, torque, angle, "hertz") for angle in angles]
    names = ("pins", "output_pins", "pressure", "output_pressure")
    own = [max(each[name].max() for each in found) for name in names]
    force = max(np.linalg.norm(each["disc_bearing"], axis=-1).max() for each in found)
    mine = [(error[-1e-3] - error[1e-3]) / ARCMIN, 0.5 * torque / (error[0.5] - error[1.0]) * ARCMIN, *own, force]
    np.testing.assert_allclose(np.array(mine) / [1, 1, 1, 1, 1e6, 1e6, 1], due, rtol=1e-3)


def test_two_discs_at_twice_the_torque_are_as_one():
    one, two = solve(v17()), solve(v17(discs=2), torque=-11.7)
    np.testing.assert_allclose(two["pins"][0], one["pins"][0], rtol=0, atol=1e-6)


def test_closed_forms_of_a_stiff_eccentric_bearing():
    """Mean over a pitch, one disc without clearance, N m on the carrier; K1 = e zp/rp."""
    e, zc, zp, n, circle = 1.3e-3, 17, 18, 6, 32.9e-3
    k1 = e * zp / 42.5e-3
    share = (1 - (1 - k1**2) / (2 * k1) * np.log((1 + k1) / (1 - k1))) / k1
    along = 2 / (np.pi * e * zc) * share - 4 / (np.pi * circle)
    bearing = np.hypot(1 / (e * zc), along)
    assert bearing == pytest.approx(52.890, abs=5e-4)
    found = [solve(v17(1e12), 1.0, 17 / 18 * crank) for crank in np.linspace(0, 2 * np.pi, 91)[:-1]]
    force = np.array([np.linalg.norm(each["disc_bearing"]) for each in found])
    assert force.mean() == pytest.approx(bearing, abs=0.01)
    assert force.min() == pytest.approx(50.89, abs=0.03) and force.max() == pytest.approx(54.00, abs=0.03)
    assert max(each["pins"].max() for each in found) == pytest.approx(4 / (e * zc * zp), rel=5e-3)
    assert max(each["output_pins"].max() for each in found) == pytest.approx(4 / (n * circle), rel=2e-3)
    alpha = 4 / (40e6 * zp * (e * zc) ** 2) + 4 / (60e6 * n * circle**2)
    assert np.mean([-each["error"] for each in found]) == pytest.approx(alpha, rel=5e-4)


def test_both_members_are_the_same_machine():
    """Equal turn of carrier against ring, torque of the ring -T zp/zc: identical forces, stiffness (zp/zc)^2 times."""
    rng = np.random.default_rng(3)
    errors = {name: 2e-6 * rng.standard_normal(shape) for name, shape in (("pin_offset", (18, 2)), ("ring_centre", 2))}
    one = solve(v17(member="carrier", **C), 4.0, 0.7, **errors)
    other = solve(v17(member="ring", **C), -4.0 * 18 / 17, 0.7 * 18 / 17, **errors)
    np.testing.assert_allclose(other["pins"], one["pins"], rtol=0, atol=1e-8)
    assert other["error"] == pytest.approx(-17 / 18 * one["error"])
    assert other["stiffness"] == pytest.approx((18 / 17) ** 2 * one["stiffness"])


def test_forces_and_torques_balance():
    """Of every disc and of the machine: input torque = output torque / ratio, but for the centring springs."""
    rng = np.random.default_rng(4)
    errors = {"hole_position": 3e-6 * rng.standard_normal((2, 6, 2)), "throw": np.array([4e-6, -2e-6])}
    errors["shaft_centre"] = np.array([5e-6, -3e-6])
    for design in (v17(discs=2), v17(discs=2, member="ring", support=50e6)):
        torque = -9.0
        found, ratio = solve(design, torque, 0.4, **errors), -17 if design["member"] == "carrier" else 18
        assert found["input_torque"] == pytest.approx(torque / ratio, rel=1e-5)
        share = 1 if ratio < 0 else -17 / 18
        assert found["disc_torque"].sum() == pytest.approx(torque * share, rel=1e-5)
        m = oracle.machine(design, errors, 0.4, torque, "linear")
        u = oracle.unit(m.drive.b)
        pins = np.einsum("kj,kjx->kx", found["pins"], m.drive.normal)
        holes = -found["output_pins"].sum(1)[:, None] * u
        np.testing.assert_allclose(pins + holes + found["disc_bearing"][:, 0], 0, atol=1e-4)


def test_one_crank_turn_with_the_pins_moved_on():
    rng = np.random.default_rng(5)
    errors = {"pin_offset": 3e-6 * rng.standard_normal((18, 2)), "pin_radii": 1e-6 * rng.standard_normal(18)}
    errors["hole_radius"] = 1e-6 * rng.standard_normal((1, 6))
    for member, ratio in (("carrier", -17), ("ring", 18)):
        one = solve(v17(member=member, **C), 3.0, 0.3, **errors)
        on = 1 if ratio < 0 else -1  # the carrier turns against the ring, or the ring with the shaft
        moved = {name: np.roll(errors[name], on, axis=0) for name in ("pin_offset", "pin_radii")}
        other = solve(v17(member=member, **C), 3.0, 0.3 + ratio * 2 * np.pi / 18, **errors | moved)
        assert other["error"] == pytest.approx(one["error"], rel=1e-9)


def test_scales_of_forces_and_of_lengths():
    base, s = v17(**C), 3.0
    one = solve(base, 5.0, contact="hertz", bearing_clearance=4e-6)
    stiff = copy.deepcopy(base)
    stiff["stiffness"]["eccentric_bearing"] *= s
    stiff["contact"]["young_modulus"] *= s
    other = solve(stiff, 5.0 * s, contact="hertz", bearing_clearance=4e-6)
    assert other["error"] == pytest.approx(one["error"], rel=1e-9)
    long = copy.deepcopy(base)
    for part, names in {
        "cycloid": ("eccentricity", "pin_circle_radius", "pin_radius", "equidistant_modification"),
        "output": ("circle_radius", "pin_radius", "hole_clearance"), "contact": ("face_width",),
        "stiffness": ("eccentric_bearing",),
    }.items():  # fmt: skip
        for name in names:
            long[part][name] *= s
    other = solve(long, 5.0 * s**3, contact="hertz", bearing_clearance=4e-6 * s)
    assert other["error"] == pytest.approx(one["error"], rel=1e-9)
    np.testing.assert_allclose(other["pins"], one["pins"] * s**2, rtol=1e-7, atol=1e-6)


def test_displaced_output_pins_and_turned_eccentrics():
    """All output pins by t: error - t/Rw. All eccentric phases p: error(angle + p) + p/i to first order."""
    t = 4e-6
    plain = solve(v17(**C), 5.0, 0.6)
    pins = solve(v17(**C), 5.0, 0.6, output_pin_offset=np.tile([0.0, t], (6, 1)))
    assert pins["error"] - plain["error"] == pytest.approx(t / 32.9e-3 * -1, rel=1e-6)
    p = 1e-4  # without clearance, whose share of the eccentricity would be of the same order as a phase
    phase, later = solve(v17(), 5.0, 0.6, eccentric_phase=np.array([p])), solve(v17(), 5.0, 0.6 + p)
    assert phase["error"] - later["error"] == pytest.approx(-p / 17, rel=3e-4)


def test_without_errors_the_first_angle_is_odd_in_the_torque():
    found = [solve(v17(**C), torque, 0.0, contact="hertz")["error"] for torque in (4.0, -4.0)]
    assert found[0] == pytest.approx(-found[1], rel=1e-9)
