"""Whole reducers and crank turns for the census, checked by full-length vectors in 80-bit numbers."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.census.cases import REAL, Case, Model, decades, deviations, moderate, nonfinite
from rvjax import RVErrors, RVReducer, catalogue, four_bar
from rvjax.designs import CrankStage
from rvjax.status import Status

READ = ("crank_eccentricity", "crank_phase", "disc_bore", "carrier_bore", "bearing_clearance", "eccentricity")


def draw_reducer(rng: Any, size: int, cranks: int, discs: int) -> Case:
    radius = decades(rng, size, -3, 1)
    e = radius * decades(rng, size, -5, -0.05)
    shapes = {"crank_eccentricity": (discs, cranks), "crank_phase": (cranks,), "eccentricity": ()}
    shapes |= {"disc_bore": (discs, cranks, 2), "carrier_bore": (cranks, 2), "bearing_clearance": ()}
    parts = {name: radius if "bore" in name else e for name in shapes} | {"crank_phase": np.ones(size)}
    case = {name: deviations(rng, (size, *shape), parts[name]) for name, shape in shapes.items()}
    torque = decades(rng, size, -4, 5) * rng.choice([-1, 0, 1], size)
    k1 = np.where(rng.uniform(size=size) < 0.1, 1 - decades(rng, size, -15, -3), rng.uniform(1e-3, 0.99, size))
    case |= dict(e=e, radius=radius, torque=torque, k1=k1, stiffness=decades(rng, size, 5, 12))
    return case | {"crank_angle": rng.uniform(-7, 7, size)}


def build(case: Case, cranks: int, discs: int) -> tuple[RVReducer, RVErrors]:
    design = catalogue.RV_40E
    cycloid = design.cycloid.replace(
        disc_count=discs, eccentricity=case["e"], pin_circle_radius=case["radius"], shortening=case["k1"]
    )
    stage = CrankStage(count=cranks, circle_radius=case["radius"], bearing_stiffness=case["stiffness"])
    return design.replace(cycloid=cycloid, cranks=stage), RVErrors(**{name: case[name] for name in READ})


def vanishing(case: Case) -> np.ndarray:
    """A torque whose square, which determines the direction of a force, is below the smallest number."""
    return (case["torque"] != 0) & (np.abs(case["torque"]) < 1e-200)


def ordinary(case: Case) -> np.ndarray:
    """Deflections below the eccentricity and errors below a third of it."""
    fit = np.abs(case["torque"]) < case["stiffness"] * case["e"] * case["e"]
    for name in READ:
        size = 1 if name == "crank_phase" else case["e"]
        fit &= np.abs(case[name]).reshape(len(fit), -1).max(1) < 0.3 * size
    return fit & moderate(case) & (np.minimum(case["e"], 0.1 * case["radius"]) > 1e-9) & (case["k1"] < 1)


def step(name: str, value: Any) -> Any:
    """A thousandth, for K1 of what it is away from 1, where a logarithm ends."""
    return 1e-3 * (np.minimum(np.abs(value), np.abs(1 - value)) if name == "k1" else np.abs(value))


def reducer(cranks: int, discs: int) -> Model:
    def run(case: Case) -> dict[str, Any]:
        design, errors = build(case, cranks, discs)
        got = four_bar.transmission_error(
            design, errors, crank_angle=case["crank_angle"], output_torque=case["torque"], closure="closed_form"
        )
        return dict(values=(got.per_disc, got.misfit), status=got.info.status,
                    residual=got.info.residual, scale=jnp.ones(()))  # fmt: skip

    def judge(case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
        turned, misfit, possible, sure, widest = plain_discs(case, cranks, discs, case["crank_angle"])
        found = np.asarray(out["values"][0])
        error = np.abs(np.angle(np.exp(1j * (found + turned)))) * sure
        error = np.maximum(error, np.abs(out["values"][1] / case["radius"][:, None] - misfit)).max(1)
        expected = np.where(possible, Status.CONVERGED, Status.INVALID_GEOMETRY)
        expected = np.where(nonfinite(case) | vanishing(case), Status.NONFINITE, expected)
        far = ~moderate(case) | (np.abs(case["crank_angle"]) > 1e4) | (np.abs(case["crank_phase"]).max(1) > 1e4)
        far |= (case["e"] < 1e-12) | (case["stiffness"] < 1e-2) | (case["radius"] < 1e-12)
        return np.where(far & (expected != Status.NONFINITE), -1, expected), np.where(far, 0, error / widest)

    return Model(
        "four_bar reducers",
        f"four_bar reducer {cranks} cranks {discs} discs",
        lambda rng, size: draw_reducer(rng, size, cranks, discs),
        run,
        judge,
        step,
        ordinary=ordinary,
    )


def plain_discs(case: Case, cranks: int, discs: int, angle: Any) -> tuple[Any, ...]:
    """Angle and misfit of every disc, whether it can be built, how sure its angle is, its widest seat.

    From full-length vectors in 80-bit numbers.
    """
    c = {k: v.astype(REAL) for k, v in case.items()}
    axis = np.exp(
        1j * (REAL("3.14159265358979323846264338327950288") * (1 + 2 * np.arange(cranks, dtype=REAL) / cranks))
    )
    e, radius, k1, torque = c["e"][:, None], c["radius"][:, None], c["k1"][:, None], c["torque"][:, None]
    kappa = np.where(
        k1 < 0.3,
        4 / REAL(np.pi) * sum(k1 ** (2 * n - 1) / (4 * n**2 - 1) for n in range(1, 30)),
        2 / REAL(np.pi) * (1 / k1 - (1 - k1**2) / (2 * k1**2) * np.log((1 + k1) / (1 - k1))),
    )
    ratio = REAL(catalogue.RV_40E.involute.sun_teeth) / catalogue.RV_40E.involute.planet_teeth
    pins, teeth = catalogue.RV_40E.cycloid.pin_count, catalogue.RV_40E.cycloid.disc_teeth
    tangential = torque / (discs * e * (pins + ratio))
    turned, misfits, sure, widest = [], [], [], REAL(1)
    for k in range(discs):
        b = np.asarray(angle, REAL)[:, None] + 2 * REAL("3.14159265358979323846264338327950288") * k / discs
        u = np.exp(1j * b)
        force = (tangential * 1j + kappa * np.abs(tangential)) * u / cranks
        force = force + e * teeth * tangential / (cranks * radius) * 1j * axis
        size = np.abs(force)
        shift = np.where(size > 0, force / np.where(size > 0, size, 1), 0) * c["bearing_clearance"][:, None]
        shift = shift + force / c["stiffness"][:, None]
        seat = (radius + c["carrier_bore"][..., 0] + 1j * c["carrier_bore"][..., 1]) * axis
        arm = e + c["eccentricity"][:, None] + c["crank_eccentricity"][:, k]
        pin = seat + arm * np.exp(1j * (b + c["crank_phase"])) + shift
        widest = np.maximum(widest, np.abs(pin).max(1) / c["radius"])
        bore = (radius + c["disc_bore"][:, k, :, 0] + 1j * c["disc_bore"][:, k, :, 1]) * axis
        pin, bore = pin - pin.mean(1, keepdims=True), bore - bore.mean(1, keepdims=True)
        moment = np.sum(np.conj(bore) * pin, 1)
        turned.append(np.angle(moment))
        sure.append(np.minimum(1, np.abs(moment) / c["radius"] ** 2))
        if cranks == 2:
            misfit = np.abs(pin[:, 1] - pin[:, 0]) - np.abs(bore[:, 1] - bore[:, 0])
        else:
            misfit = np.sqrt(2 * np.sum(np.abs(pin - np.exp(1j * turned[-1])[:, None] * bore) ** 2, 1))
        misfits.append(misfit / c["radius"])
    widest = np.asarray(widest + 0 * c["radius"], float)
    possible = (case["radius"] > 0) & (case["k1"] < 1) & (case["k1"] > 0) & (case["e"] > 0) & (case["stiffness"] > 0)
    if cranks == 2:
        possible &= 2 * case["radius"] + case["carrier_bore"][..., 0].sum(1) > 0
    return (
        *tuple(np.stack(x, 1).astype(float) for x in (turned, misfits)),
        possible,
        np.stack(sure, 1).astype(float),
        widest,
    )


def turn(cranks: int, discs: int, angles: int) -> Model:
    """Figures of a crank turn against its curve: two ways through the same model."""

    def run(case: Case) -> dict[str, Any]:
        design, errors = build(case, cranks, discs)
        got = four_bar.revolution(design, errors, angles=angles, output_torque=case["torque"])
        values = (got.maximum, got.minimum, got.largest_misfit)
        return dict(values=values, status=got.info.status, residual=got.info.residual, scale=jnp.ones(()),
                    curve=got.error, misfit=got.misfit)  # fmt: skip

    def judge(case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
        most, least, misfit = out["values"]
        curve = out["curve"]
        error = np.abs(most - curve.max(1)) + np.abs(least - curve.min(1))
        # Where a disc is turned by half a turn, rounding decides the sign of the angle.
        seam = discs * np.abs(curve).max(1) > np.pi * (1 - 1e-9)
        misfit = misfit / case["radius"]
        largest = np.abs(out["misfit"]).max((1, 2)) / case["radius"]
        error = np.maximum(np.where(seam, 0, error), np.abs(misfit - largest) / np.maximum(1, largest))
        possible = plain_discs(case, cranks, discs, 0 * case["e"])[2]
        expected = np.where(possible, Status.CONVERGED, Status.INVALID_GEOMETRY)
        del case["crank_angle"]
        expected = np.where(nonfinite(case) | vanishing(case), Status.NONFINITE, expected)
        case["crank_angle"] = 0 * case["e"]
        sound = moderate(case) & (np.abs(case["crank_phase"]).max(1) < 1e4) & (case["e"] > 1e-12)
        sound &= (case["stiffness"] > 1e-2) & (case["radius"] > 1e-12)
        return np.where(~sound & (expected != Status.NONFINITE), -1, expected), np.where(sound, error, 0)

    return Model(
        "four_bar reducers",
        f"four_bar turn {cranks} cranks {discs} discs {angles} angles",
        lambda rng, size: draw_reducer(rng, size, cranks, discs),
        run,
        judge,
        step,
        ordinary=ordinary,
    )
