"""Errors as excitation of the dynamic model: independent cases (tests/reference/dynamic_error.json).

1e-9 of the largest amplitude of the same output, 1e-7 with the varying mesh. The sun's rotation is what is left of
motions `ratio` times as large as the output's, so that a reference in double precision knows it to eps * ratio *
condition (128) of those; in case 316, where that is more than 1e-9, 40 digits are closer to rvjax than to it.
"""

from fractions import Fraction

import numpy as np
import pytest

from rvjax import (
    CrankStage,
    CycloidStage,
    Damping,
    Inertia,
    InvoluteStage,
    MeshVariation,
    RVErrors,
    RVReducer,
    Status,
    Stiffness,
    dynamics,
)

OUTPUTS = ("output.rotation", "sun.rotation", "transmission_error")
FURTHER = [pytest.param(number, marks=pytest.mark.long) for number in (312, 313, 314, 315, 316, 317)]
STAGE = {"sp": "planetary", "cp": "cycloid"}


def numbers(record, t, names):
    return record(*[t[name] for name in names.split()])


def reducer(table, changes):
    t = {**table, **changes}
    return RVReducer(
        InvoluteStage(t["zs"], t["zp"], 1e-3, t["alpha"], 1.0, 1.0, t["rs"], t["rp"]),
        CycloidStage(
            *(t["Zpin"] - 1, t["Zpin"], t["N"], t["e"], t["Rpin"], 1e-3), force_angle=t["beta"], disc_phase=t["psi_c0"]
        ),
        CrankStage(t["M"], t["rH"]),
        inertia=numbers(Inertia, t, "ms Js mp Jp mH JH mc Jc mo Jo"),
        stiffness=numbers(Stiffness, t, "ks kst ka kH kHb kcb ksp kcr ko kot"),
        mesh_variation=numbers(MeshVariation, t, "sw_sp duty_sp ramp_sp sw_cp duty_cp ramp_cp"),
        damping=Damping(t["eta"], t["ray_a"], t["ray_b"]),
    )


def unit(errors):
    return RVErrors(**{name: np.asarray(value) for name, value in errors.items()})


def phasors(values):
    values = np.asarray(values, float)
    return values[..., 0] + 1j * values[..., 1]


@pytest.fixture(scope="module")
def cases(reference):
    file = reference("dynamic_error")
    return {case["id"]: {**case, "design": reducer(file["table"], case["changes"])} for case in file["cases"]}


def assert_lines(found, expected, rtol, ratio):
    """Lines (orders, outputs) in the order of OUTPUTS."""
    largest = np.abs(expected).max(axis=0)
    allowed = rtol * largest
    allowed[1] = max(allowed[1], 128 * np.finfo(float).eps * ratio * largest[0])
    assert (np.abs(np.asarray(found) - expected).max(axis=0) <= allowed).all()


# By default one layout of each kind: the closed form at standstill, responses and statistics have the others.
LAYOUTS = [pytest.param(number, marks=pytest.mark.long) for number in (302, 303, 307)]


@pytest.mark.parametrize("number", [301, 304, 305, 306, *LAYOUTS])
def test_transfer_is_that_of_the_reference(cases, number):
    case = cases[number]
    frequency, load = case.get("frequency", 0.0), case.get("load_inertia", 0.0)
    found = dynamics.error_transfer(case["design"], frequency=frequency, load_inertia=load, outputs=OUTPUTS)
    if case["kind"] == "static":
        np.testing.assert_allclose(found[0], case["out"], rtol=1e-9)
        assert np.abs(found[1]).max() < 1e-12 * np.abs(found[0]).max() * case["design"].ratio
    else:
        assert_lines(found.T, phasors(case["out"]).T, 1e-9, case["design"].ratio)


# Responses have the errors of 308 and 309.
@pytest.mark.parametrize("number", [*(pytest.param(n, marks=pytest.mark.long) for n in (308, 309)), 310])
def test_excitation_is_that_of_the_reference(cases, number):
    case = cases[number]
    found = dynamics.error_excitation(case["design"], unit(case["errors"]), pin_harmonics=case["pin_harmonics"])
    expected = {float(Fraction(order)): phasors(values) for order, values in case["out"].items()}
    constant = expected.pop(0.0)
    np.testing.assert_array_equal(found.order, sorted(expected))
    rows = np.array([expected[n] for n in sorted(expected)])
    np.testing.assert_allclose(found.amplitude, rows, rtol=0, atol=1e-9 * np.abs(rows).max())
    np.testing.assert_allclose(found.mean, constant.real, rtol=0, atol=1e-9 * np.abs(constant).max())
    cancelled = (rows == 0).all(axis=0)
    assert cancelled.any() and (np.asarray(found.amplitude)[:, cancelled] == 0).all()


@pytest.mark.parametrize("number", [311, *FURTHER])
def test_response_is_that_of_the_reference(cases, number):
    case = cases[number]
    options = {name: case[name] for name in ("sun_speed", "load_inertia", "pin_harmonics")}
    found = dynamics.transmission_error(case["design"], unit(case["errors"]), outputs=OUTPUTS, **options)
    expected = {float(Fraction(order)): phasors(values) for order, values in case["out"]["amplitude"].items()}
    np.testing.assert_array_equal(found.order, sorted(expected))
    assert found.info.status == Status.CONVERGED and found.info.residual < 1e-13
    assert_lines(found.amplitude, np.array([expected[n] for n in sorted(expected)]), 1e-9, case["design"].ratio)
    np.testing.assert_allclose(found.peak_to_peak, case["out"]["peak_to_peak"], rtol=2e-8)
    turns = case["sun_speed"] / case["design"].ratio / (2 * np.pi)
    np.testing.assert_allclose(found.frequency, np.abs(turns) * np.array(sorted(expected)), rtol=1e-12)


@pytest.mark.long  # lines of a sweep are those of the response, test_dynamics_error.py
def test_sweep_is_that_of_the_reference(cases):
    case = cases[318]
    options = {name: case[name] for name in ("load_inertia", "pin_harmonics")}
    found = dynamics.speed_sweep(
        case["design"], unit(case["errors"]), sun_speeds=np.array(case["sun_speeds"]), **options
    )
    np.testing.assert_array_equal(found.order, [40.0])
    np.testing.assert_allclose(found.peak[:, 0], case["out"]["peak"], rtol=1e-9)
    np.testing.assert_allclose(found.peak_speed[:, 0], case["out"]["peak_speed"])
    for end, place in (("first", 0), ("last", -1)):
        np.testing.assert_allclose(np.abs(found.amplitude[place, :, 0]), case["out"][end], rtol=1e-9)


def test_statistics_are_those_of_the_reference(cases):
    case = cases[319]
    options = {name: case[name] for name in ("sun_speed", "load_inertia")}
    found = dynamics.error_statistics(case["design"], unit(case["sigma"]), **options)
    power, pseudo = case["out"]["40"]
    np.testing.assert_allclose(found.power[:, 0], [power], rtol=1e-9)
    np.testing.assert_allclose(found.pseudo_power[:, 0], [complex(*pseudo)], rtol=1e-9)


@pytest.mark.long  # a march in time holds both together by default
@pytest.mark.parametrize("number", [320, 321])
def test_errors_and_mesh_together_are_those_of_the_reference(cases, number):
    case = cases[number]
    found = dynamics.transmission_error(
        *(case["design"], unit(case["errors"])),
        sun_speed=case["sun_speed"],
        outputs=OUTPUTS,
        pin_harmonics=0,
        method="harmonic_balance",
        stage=STAGE[case["stage"]],
        harmonics=case["harmonics"],
        output_torque=-3136.0,
    )
    expected = {float(Fraction(order)): phasors(values) for order, values in case["out"].items()}
    largest = np.argsort(-np.abs(np.asarray(found.amplitude)[:, 0]))[: len(expected)]
    assert set(np.asarray(found.order)[largest]) == set(expected)
    rows = np.array([expected[float(found.order[n])] for n in largest])
    assert_lines(found.amplitude[largest], rows, 1e-7, case["design"].ratio)
