"""Four-bar linkages for the census, checked by closure in 80-bit numbers."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.census.cases import REAL, Case, Model, decades, deviations, moderate, nonfinite
from rvjax import LinkDeviations, four_bar
from rvjax.status import Status

LINKS = ("crank_1", "coupler", "crank_3", "frame", "crank_phase", "frame_angle")


def linkage(cranks: str, branch: str, closure: str) -> Model:
    def draw(rng: Any, size: int) -> Case:
        l = decades(rng, size, -3, 1)  # noqa: E741
        e = l * decades(rng, size, -5, -0.05)
        turn = np.pi * rng.choice([0, 0.5, 1, 1.5, -1, 200], size)
        near = turn + decades(rng, size, -9, -1) * rng.choice([-1, 0, 1], size)
        case = {
            "e": e,
            "l": l,
            "crank_angle": np.where(rng.uniform(size=size) < 0.3, near, rng.uniform(-7, 7, size)),
            "joint": deviations(rng, (size, 2), e),
            **{name: deviations(rng, (size,), e if "crank" in name or rng.uniform() < 0.8 else l) for name in LINKS},
        }
        case["crank_phase"] /= e
        case["frame_angle"] /= e
        if cranks == "geared":
            largest = sum(np.abs(case[name]) for name in ("crank_1", "coupler", "crank_3", "frame"))
            largest = largest / e + np.abs(case["crank_phase"]) + np.abs(case["joint"]).sum(1) / e
            largest = largest + np.abs(case["frame_angle"]) * l / e
            case["ratio"] = np.maximum(decades(rng, size, -1, 3), 3 * largest)
        return case

    def run(case: Case) -> dict[str, Any]:
        got = four_bar.solve_closure(
            case["e"],
            case["l"],
            LinkDeviations(joint=case["joint"], **{name: case[name] for name in LINKS}),
            crank_angle=case["crank_angle"],
            cranks=cranks,
            branch=branch,
            closure=closure,
            gear_stiffness_ratio=case.get("ratio"),
        )
        out = dict(values=got.coupler_angle, status=got.info.status, residual=got.info.residual, scale=jnp.ones(()))
        if cranks == "geared":  # what the lengths would pull, of which the residual is a difference
            pull = sum(jnp.abs(case[name]) for name in ("crank_1", "coupler", "crank_3", "frame"))
            pull = (pull + jnp.sum(jnp.abs(case["joint"]))) * jnp.abs(case["e"] + case["crank_3"]) / case["e"] ** 2
            pull = jnp.where(jnp.isfinite(pull), pull, 0)
            out["residual_scale"] = 1 + pull * (1 + pull / case["ratio"])  # many revolutions round coarsely
        return out

    return Model(
        "four_bar closures",
        f"four_bar linkage {cranks} {branch} {closure}",
        draw,
        run,
        functools.partial(judge_linkage, cranks, branch),
        lambda name, v: 1e-3 * np.maximum(np.abs(v), 1e-6),
        ordinary=ordinary,
        sound=lambda c: moderate(c) & (np.minimum(c["e"], c["l"]) > 1e-12) & (np.abs(c["crank_3"]) < 1e3 * c["e"]),
    )


def ordinary(case: Case) -> np.ndarray:
    """Off the dead points, cranks shorter than the coupler, deviations below a third of them."""
    largest = np.max([np.abs(case[name]) for name in ("crank_1", "coupler", "crank_3", "frame")], axis=0)
    largest = np.maximum(largest, np.abs(case["joint"]).max(1)) + np.abs(case["frame_angle"]) * case["l"]
    fit = (
        (case["e"] > 1e-6 * case["l"])
        & (case["e"] < 0.9 * case["l"])
        & (largest < 0.3 * case["e"])
        & (np.abs(case["crank_phase"]) < 0.3)
    )
    return fit & moderate(case, 1e6) & (np.abs(np.sin(case["crank_angle"])) > 0.3)


def judge_linkage(cranks: str, branch: str, case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
    """Closure in 80-bit numbers: the free coupler ends on the circle of crank 3, on the right side."""
    c = {k: v.astype(REAL) for k, v in case.items()}
    b2, status = np.asarray(out["values"]).astype(REAL), out["status"]
    l2, l4 = c["l"] + c["coupler"], c["l"] + c["frame"]
    l1, l3 = c["e"] + c["crank_1"], c["e"] + c["crank_3"]
    pin1 = l1 * np.exp(1j * c["crank_angle"])
    frame = l4 * np.exp(1j * c["frame_angle"]) + c["joint"][:, 0] + 1j * c["joint"][:, 1]
    possible = (c["l"] > 0) & (l2 > 0) & (l4 > 0)
    if cranks == "free":
        possible &= (l1 > 0) & (l3 > 0)
    elif cranks == "geared":
        possible &= (c["e"] > 0) & (c["ratio"] > 0)
    expected = np.full(status.shape, -1)
    size = np.abs(frame) + np.abs(l2) + np.abs(l1) + np.abs(l3)
    if cranks == "free":
        reach = frame - pin1
        slack = np.minimum(l2 + l3 - np.abs(reach), np.abs(reach) - np.abs(l2 - l3))
        sine = (pin1 * frame.conj()).imag / (np.abs(pin1) * np.abs(frame))
        clear = (np.abs(slack) > 1e-12 * size) & (np.abs(sine) > 1e-5)
        expected = np.where(clear & (slack > 0), Status.CONVERGED, expected)
        expected = np.where(clear & (slack < 0), Status.NOT_ASSEMBLABLE, expected)
        coupler = l2 * np.exp(1j * b2)
        off = np.abs(np.abs(pin1 + coupler - frame) - l3) / size
        side = np.sign((reach.conj() * coupler).imag) * np.sign(sine) * (1 if branch == "open" else -1)
        # what b2 carries of rounding near the fold
        error = np.where((side < 0) & clear & (slack > 1e-9 * size), np.inf, off)
    elif cranks == "phase_locked":
        expected = np.where(possible, Status.CONVERGED, expected)
        v = frame + l3 * np.exp(1j * (c["crank_angle"] + c["crank_phase"])) - pin1
        error = np.abs(np.angle(np.exp(1j * b2) / (v / np.abs(v)))) * np.abs(v) / size
    else:
        expected = np.where(possible, Status.CONVERGED, expected)

        def energy(slip: Any) -> Any:
            v = frame + l3 * np.exp(1j * (c["crank_angle"] + c["crank_phase"] + slip)) - pin1
            return (np.abs(v) - l2) ** 2 / c["e"] ** 2 + c["ratio"] * slip**2, np.angle(v)

        slip = np.zeros_like(l2)
        for _ in range(60):
            h = REAL(1e-6)
            (f1, _), (f0, _), (f2, _) = energy(slip - h), energy(slip), energy(slip + h)
            slope, bend = (f2 - f1) / (2 * h), (f2 - 2 * f0 + f1) / h**2
            slip = slip - slope / np.maximum(np.abs(bend), c["ratio"])
        error = np.abs(np.angle(np.exp(1j * (b2 - energy(slip)[1]))))
        error = np.where(error < 1e-6, 0, error)  # differences leave so much
        # Gears softer than the misfit they must hold leave several places of rest: out of the domain.
        v = frame + l3 * np.exp(1j * (c["crank_angle"] + c["crank_phase"])) - pin1
        worn = (c["ratio"] < 1e-2) | (c["ratio"] < np.abs(np.abs(v) - l2) / c["e"])
        worn |= (l3 > 2 * c["e"]) | (l3 < 0)
        expected, error = np.where(possible & worn, -1, expected), np.where(worn, 0, error)
    expected = np.where(possible, expected, Status.INVALID_GEOMETRY)
    expected = np.where(nonfinite(case), Status.NONFINITE, expected)
    far = ~moderate(case, 1e15) | (size > 1e4 * np.abs(c["l"])) | (np.abs(c["crank_angle"]) > 1e4)
    huge = ~moderate(case, 1e15) | (np.abs(case["l"]) < 1e-12)  # too large for the arithmetic goes before impossible
    expected = np.where(huge & (expected != Status.NONFINITE), -1, expected)
    return np.where(far & np.isin(expected, (Status.CONVERGED, Status.NOT_ASSEMBLABLE)), -1, expected), np.where(
        far, 0, error
    ).astype(float)
