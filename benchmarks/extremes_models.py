"""The models of the census: how inputs are drawn, how one is run, and what an independent computation says."""

import functools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

import extremes_mesh
import rvjax
from rvjax import LinkDeviations, RVErrors, RVReducer, catalogue, four_bar, lost_motion
from rvjax.designs import CrankStage, CycloidStage, InvoluteStage
from rvjax.lost_motion.reducer import ERRORS_READ, PROFILES
from rvjax.status import Status

Case = dict[str, Any]
REAL = np.longdouble  # of the judges


class Model(NamedTuple):
    """One model with its static options; `run` gives values, status, residual and the scale of the values."""

    name: str
    draw: Callable[[Any, int], Case]
    run: Callable[[Case], dict[str, Any]]
    judge: Callable[[Case, Any], tuple[np.ndarray, np.ndarray]]  # status due (-1: not known), error over scale
    step: Callable[[str, Any], Any]  # size of a change of an input that matters
    ordinary: Callable[[Case], Any] = lambda case: True  # where float32 is promised a bound
    nan_when_failed: bool = True


def models() -> Iterator[Model]:
    """All of them."""
    for cranks, branch, closure in (
        ("free", "open", "newton"),
        ("free", "open", "closed_form"),
        ("free", "crossed", "newton"),
        ("free", "crossed", "closed_form"),
        ("phase_locked", "open", "newton"),
        ("phase_locked", "open", "closed_form"),
        ("geared", "open", "newton"),
    ):
        yield linkage(cranks, branch, closure)
    for cranks, discs in ((2, 1), (2, 2), (3, 1), (8, 1)):
        yield reducer(cranks, discs)
    for cranks, discs, angles in ((2, 2, 64), (3, 1, 7)):
        yield turn(cranks, discs, angles)
    for profile in PROFILES:
        for teeth in (2, 39, 200):
            yield play(profile, teeth)
    for contact in ("hertz", "linear", "palmgren"):
        for teeth in (2, 3, 25, 60) + ((200,) if contact == "hertz" else ()):
            yield mesh(contact, teeth)
    for stage, cranks, discs, method in (
        ("planetary", 4, 3, "first_order"),
        ("cycloid", 3, 2, "first_order"),
        ("planetary", 2, 1, "first_order"),
        ("cycloid", 8, 8, "first_order"),
        ("planetary", 3, 3, "harmonic_balance"),
        ("planetary", 2, 2, "harmonic_balance"),
    ):
        yield vibration(stage, cranks, discs, method)


def decades(rng: Any, size: Any, low: float, high: float) -> np.ndarray:
    """Positive numbers, even in their logarithm."""
    return 10 ** rng.uniform(low, high, size)


def deviations(rng: Any, shape: tuple[int, ...], part: np.ndarray) -> np.ndarray:
    """Errors from nothing to the size of the part; some are exactly zero, some exactly equal to the part."""
    lanes = (shape[0],) + (1,) * (len(shape) - 1)
    size = part.reshape(lanes) * decades(rng, lanes, -12, 0) * (rng.uniform(size=lanes) > 0.1)
    value = size * rng.uniform(-1, 1, shape) * (rng.uniform(size=shape) > 0.2)
    return np.where(rng.uniform(size=shape) < 0.002, -part.reshape(lanes), value)


def spoiled(case: Case, rng: Any, share: float = 0.03) -> Case:
    """A few lanes with one number that is not one, or far outside the domain."""
    names, lanes = list(case), len(next(iter(case.values())))
    for lane in np.flatnonzero(rng.uniform(size=lanes) < share):
        value = case[names[rng.integers(len(names))]][lane : lane + 1].reshape(-1)
        bad = (np.nan, np.inf, -np.inf, 0.0, -1.0, -abs(value[0]), 1e300, 1e-300, 1e30, -1e30, 1e-30)
        value[rng.integers(len(value))] = bad[rng.integers(len(bad))]
    return case


def nonfinite(case: Case) -> np.ndarray:
    return np.any([~np.isfinite(v.reshape(len(v), -1)).all(1) for v in case.values()], axis=0)


def moderate(case: Case, top: float = 1e12) -> np.ndarray:
    """Lanes without numbers so large that their squares or products overflow."""
    return np.all([(np.abs(v.reshape(len(v), -1)) < top).all(1) for v in case.values()], axis=0)


def relative_step(name: str, value: Any) -> Any:
    """A thousandth of the number itself; zeros stay zero: no torque is where a model jumps."""
    return 1e-3 * np.abs(value)


# --- four-bar linkage

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
        return dict(values=got.coupler_angle, status=got.info.status, residual=got.info.residual, scale=jnp.ones(()))

    return Model(
        f"four_bar linkage {cranks} {branch} {closure}",
        draw,
        run,
        functools.partial(judge_linkage, cranks, branch),
        lambda name, v: 1e-3 * np.maximum(np.abs(v), 1e-6),
        ordinary=lambda c: np.abs(np.sin(c["crank_angle"])) > 0.3,
    )


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
    expected = np.where(possible, expected, Status.INVALID_GEOMETRY)
    expected = np.where(nonfinite(case), Status.NONFINITE, expected)
    if cranks == "geared":  # gears so soft that slips overflow
        expected = np.where(possible & (c["ratio"] < 1e-2), -1, expected)
        error = np.where(c["ratio"] < 1e-2, 0, error)
    far = ~moderate(case, 1e15) | (size > 1e4 * np.abs(c["l"])) | (np.abs(c["crank_angle"]) > 1e4)
    return np.where(far & (expected == Status.CONVERGED), -1, expected), np.where(far, 0, error).astype(float)


# --- whole reducers

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


def reducer(cranks: int, discs: int) -> Model:
    def run(case: Case) -> dict[str, Any]:
        design, errors = build(case, cranks, discs)
        got = four_bar.transmission_error(
            design, errors, crank_angle=case["crank_angle"], output_torque=case["torque"], closure="closed_form"
        )
        return dict(values=(got.per_disc, got.misfit), status=got.info.status,
                    residual=got.info.residual, scale=jnp.ones(()))  # fmt: skip

    def judge(case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
        turned, misfit, possible, sure = plain_discs(case, cranks, discs, case["crank_angle"])
        found = np.asarray(out["values"][0])
        error = np.abs(np.angle(np.exp(1j * (found + turned)))) * sure
        error = np.maximum(error, np.abs(out["values"][1] / case["radius"][:, None] - misfit)).max(1)
        expected = np.where(possible, Status.CONVERGED, Status.INVALID_GEOMETRY)
        expected = np.where(nonfinite(case), Status.NONFINITE, expected)
        far = ~moderate(case) | (np.abs(case["crank_angle"]) > 1e4) | (np.abs(case["crank_phase"]).max(1) > 1e4)
        far |= (case["e"] < 1e-12) | (case["stiffness"] < 1e-2) | (case["radius"] < 1e-12)
        size = np.maximum(1, np.abs(misfit).max(1))
        return np.where(far & possible, -1, expected), np.where(far, 0, error / size).astype(float)

    return Model(
        f"four_bar reducer {cranks} cranks {discs} discs",
        lambda rng, size: draw_reducer(rng, size, cranks, discs),
        run,
        judge,
        relative_step,
        ordinary=lambda c: np.abs(c["torque"]) / (c["stiffness"] * c["e"] * c["radius"]) < 1,
    )


def plain_discs(case: Case, cranks: int, discs: int, angle: Any) -> tuple[Any, Any, Any, Any]:
    """Angle and misfit of every disc from full-length vectors in 80-bit numbers."""
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
    turned, misfits, sure = [], [], []
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
    possible = (case["radius"] > 0) & (case["k1"] < 1) & (case["k1"] > 0) & (case["e"] > 0) & (case["stiffness"] > 0)
    if cranks == 2:
        possible &= 2 * case["radius"] + case["carrier_bore"][..., 0].sum(1) > 0
    return (*tuple(np.stack(x, 1).astype(float) for x in (turned, misfits)), possible, np.stack(sure, 1).astype(float))


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
        _, _, possible, _ = plain_discs(case, cranks, discs, 0 * case["e"])
        expected = np.where(possible, Status.CONVERGED, Status.INVALID_GEOMETRY)
        del case["crank_angle"]
        expected = np.where(nonfinite(case), Status.NONFINITE, expected)
        case["crank_angle"] = 0 * case["e"]
        sound = moderate(case) & (np.abs(case["crank_phase"]).max(1) < 1e4) & (case["e"] > 1e-12)
        sound &= (case["stiffness"] > 1e-2) & (case["radius"] > 1e-12)
        return np.where(~sound & possible, -1, expected), np.where(sound, error, 0)

    return Model(
        f"four_bar turn {cranks} cranks {discs} discs {angles} angles",
        lambda rng, size: draw_reducer(rng, size, cranks, discs),
        run,
        judge,
        relative_step,
        ordinary=lambda c: np.abs(c["torque"]) / (c["stiffness"] * c["e"] * c["radius"]) < 1,
    )


# --- lost motion

PLAY = ERRORS_READ


def play(profile: str, teeth: int) -> Model:
    def draw(rng: Any, size: int) -> Case:
        rp = decades(rng, size, -3, 1)
        k1 = np.where(rng.uniform(size=size) < 0.1, 1 - decades(rng, size, -15, -3), rng.uniform(1e-4, 0.999, size))
        e = k1 * rp / (teeth + 1)
        small = 10 ** rng.uniform(-10, 0.5, size) * np.where(rng.uniform(size=size) < 0.9, 1e-2, 1)
        case = {name: e * small * rng.uniform(-1, 1, size) * (rng.uniform(size=size) > 0.15) for name in PLAY}
        case |= {name: e * small * rng.uniform(-1, 1, size) for name in ("equidistant", "shift")}
        case |= dict(e=e, rp=rp, r1=decades(rng, size, -3, 0), a0=decades(rng, size, -3, 0))
        case |= dict(alpha=rng.uniform(0, 1.5, size), tilt=rng.uniform(-1.6, 1.6, size) * decades(rng, size, -6, 0))
        return case

    def run(case: Case) -> dict[str, Any]:
        involute = InvoluteStage(12, 42, 1.0, case["alpha"], case["a0"], case["r1"], 1.0, 1.0)
        cycloid = CycloidStage(
            disc_teeth=teeth, pin_count=teeth + 1, disc_count=2, eccentricity=case["e"],
            pin_circle_radius=case["rp"], pin_radius=1.0, equidistant_modification=case["equidistant"],
            shift_modification=case["shift"],
        )  # fmt: skip
        design = RVReducer(involute, cycloid, CrankStage(2, 1.0))
        errors = RVErrors(**{name: case[name] for name in PLAY})
        got = lost_motion.geometric(design, errors, profile=profile, tilt=case["tilt"])
        size = sum(jnp.abs(leaf) for leaf in jax.tree.leaves(got.terms))
        return dict(values=got.total, status=got.info.status, residual=jnp.zeros(()),
                    scale=jnp.where(size > 0, size, 1.0), flank=got.terms)  # fmt: skip

    return Model(
        f"lost_motion {profile} {teeth} teeth",
        draw,
        run,
        functools.partial(judge_play, profile, teeth),
        lambda name, v: 1e-3 * np.abs(v),
        ordinary=lambda c: c["e"] * (teeth + 1) < 0.99 * c["rp"],
    )


def judge_play(profile: str, teeth: int, case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
    """The sum of the paper in 80-bit numbers; the exact flank by a search over 4000 points, then finer ones."""
    c = {k: v.astype(REAL) for k, v in case.items()}
    e, rp, zp = c["e"], c["rp"], teeth + 1
    k1 = e * zp / rp
    s = np.sqrt((1 - k1) * (1 + k1))
    D = c["equidistant"] + c["equidistant_modification"] - c["pin_radius"] + c["pin_hole_clearance"] / 2
    d = c["shift"] + c["shift_modification"] - c["pin_circle_radius"]
    k_n = c["equidistant"] / (e**2 * teeth) - (zp**2 / (teeth * rp**2 * s) + s / (e**2 * teeth)) * c["shift"]
    ratio = 1 + REAL(42) * zp / 12
    rest = -(c["base_tangent_upper"] + c["base_tangent_lower"]) / (2 * c["r1"] * ratio * np.cos(c["alpha"]))
    rest = rest + (c["disc_runout"] / 2 + 2 * k1 * c["pin_position"] - k1 * c["disc_cumulative_pitch"]) / (e * teeth)
    rest = rest + 2 * c["bearing_clearance"] * np.cos(c["tilt"]) / c["a0"]
    possible = (e > 0) & (rp > 0) & (c["r1"] > 0) & (c["a0"] > 0) & (k1 < 1)
    possible &= (np.cos(c["alpha"]) > 0) & (np.abs(c["tilt"]) < REAL(np.pi) / 2)
    E, ring, ground = e + c["eccentricity"], rp + c["pin_circle_radius"], rp + c["pin_circle_radius"] + d
    assembles = np.ones_like(possible)
    unsure = np.abs(1 - k1) < 1e-14
    if profile == "first_order":
        total = rest + 2 * (D - s * d) / (e * teeth) - 2 * k_n * c["eccentricity"]
    else:
        K = E * zp / ground if profile == "contact" else k1 * E / e
        possible &= (E > 0) & (ring > 0) & (ground > 0) & (K < 1)
        unsure |= np.abs(1 - K) < 1e-14
        assembles = d <= D
        unsure |= np.abs(d - D) <= 1e-12 * (np.abs(c["shift"]) + np.abs(c["equidistant"]) + np.abs(d) + np.abs(D))
        s = np.sqrt((1 - K) * (1 + K))
        flank = np.where(d <= s * D, 2 * (D - s * d), 2 * K * np.sqrt(np.maximum(D**2 - d**2, 0))) / (E * teeth)
        if profile == "contact":
            flank = 2 * scan(E, ring, ground, K, D, d, teeth)
        total = rest + flank
    error = np.abs(out["values"] - total) / out["scale"] * (1 - k1)  # K1 is known to a rounding of e zp / rp
    expected = np.where(
        possible, np.where(assembles, Status.CONVERGED, Status.NOT_ASSEMBLABLE), Status.INVALID_GEOMETRY
    )
    if profile == "contact":  # deviations beyond the smallest radius of curvature leave no flank to search
        none = (status_of(out) == Status.MAX_STEPS) & ((np.abs(D) + np.abs(d)) / E > 0.1 * (1 - K))
        unsure |= none & possible & assembles
    expected = np.where(unsure, -1, expected)
    expected = np.where(nonfinite(case), Status.NONFINITE, expected)
    far = ~moderate(case) | (np.minimum.reduce([case[n] for n in ("e", "rp", "r1", "a0")]) < 1e-12)
    return np.where(far & (expected != Status.NONFINITE), -1, expected), np.where(far, 0, error).astype(float)


def status_of(out: Any) -> np.ndarray:
    return np.asarray(out["status"])


def scan(E: Any, ring: Any, ground: Any, K: Any, D: Any, d: Any, teeth: int) -> np.ndarray:
    """Least free rotation over the flank, 80-bit: a grid over ln tan(phi / 2), refined around its best point."""
    E, ring, ground, K, D, d = (np.asarray(x, REAL)[:, None] for x in (E, ring, ground, K, D, d))
    centre, half = np.zeros_like(E), REAL(20)
    for number in range(16):
        points = 401 if number == 0 else 21
        t = np.exp(centre + half * np.linspace(-1, 1, points, dtype=REAL))
        cos, sin, low = (1 - t**2) / (1 + t**2), 2 * t / (1 + t**2), 2 * t**2 / (1 + t**2)
        S = np.sqrt((1 - K) ** 2 + 2 * K * low)
        delta = -d * (ring + ground) + 2 * E * d * cos + 2 * D * (ground * (1 - K * cos) - E * (cos - K)) / S - D**2
        delta = delta / (2 * ring * E)
        square = (low - delta) * (2 - low + delta)
        turned = np.where(square > 0, np.sqrt(np.where(square > 0, square, 1)), 1)
        h = np.arctan(-delta / (sin + turned))
        phi = np.arctan2(sin, cos)
        p = ring - E * np.exp(1j * (phi + 2 * h))
        m = d + 2j * E * np.sin(h) * np.exp(1j * (phi + h)) - D * (1 - K * np.exp(1j * phi)) / S
        b = np.where(square > 0, np.arctan2((m * p.conj()).imag, ((p + m) * p.conj()).real) - 2 * h / teeth, np.inf)
        best = np.argmin(b, 1)[:, None]
        centre = centre + half * np.take_along_axis(
            np.broadcast_to(np.linspace(-1, 1, points, dtype=REAL), b.shape), best, 1
        )
        half = half * (4 / REAL(points - 1)) if number == 0 else half / 5
    return np.take_along_axis(b, best, 1)[:, 0]


# --- roller stage


def mesh(contact: str, teeth: int) -> Model:
    return Model(
        f"mesh_force {contact} {teeth} teeth",
        lambda rng, size: extremes_mesh.draw(rng, size, teeth),
        functools.partial(extremes_mesh.run, contact, teeth),
        functools.partial(extremes_mesh.judge, contact, teeth),
        relative_step,
        ordinary=functools.partial(extremes_mesh.ordinary, teeth),
    )


# --- dynamics

SPRINGS = ("sun_support", "sun_torsion", "planet_crank_bending", "planet_crank_torsion", "support_bearing",
           "turning_arm_bearing", "sun_planet_mesh", "disc_pin_mesh", "output_support", "output_torsion")  # fmt: skip
MASSES = ("sun_mass", "sun_inertia", "planet_mass", "planet_inertia", "crank_mass", "crank_inertia", "disc_mass",
          "disc_inertia", "output_mass", "output_inertia")  # fmt: skip
SWINGS = ("planetary_swing", "planetary_duty", "cycloid_swing", "cycloid_duty")


def vibration(stage: str, cranks: int, discs: int, method: str) -> Model:
    base = catalogue.RV_320E

    def draw(rng: Any, size: int) -> Case:
        def around(value: float, spread: float = 1.0) -> np.ndarray:
            return value * decades(rng, size, -spread, spread)

        case = {name: around(getattr(base.stiffness, name) or 1e7) for name in SPRINGS}
        for name in ("sun_support", "sun_torsion", "output_support", "output_torsion"):
            case[name] *= rng.uniform(size=size) > 0.3
        case |= {name: around(getattr(base.inertia, name)) for name in MASSES}
        case |= {name: rng.uniform(0, 0.9, size) * (rng.uniform(size=size) > 0.05) for name in SWINGS}
        speed = decades(rng, size, -3, 4) * rng.choice([-1, 1], size) * (rng.uniform(size=size) > 0.02)
        torque = decades(rng, size, -4, 5) * rng.choice([-1, 0, 1], size)
        case |= dict(e=around(2.2e-3), radius=around(0.0635), sun_base=around(0.01), planet_base=around(0.05))
        case |= dict(force_angle=rng.uniform(-1.4, 1.4, size), alpha=rng.uniform(0.1, 0.6, size))
        return case | dict(loss=decades(rng, size, -4, -0.5), speed=speed, torque=torque)

    def run(case: Case) -> dict[str, Any]:
        involute = base.involute.replace(
            sun_base_radius=case["sun_base"], planet_base_radius=case["planet_base"], pressure_angle=case["alpha"]
        )
        cycloid = base.cycloid.replace(disc_count=discs, eccentricity=case["e"], force_angle=case["force_angle"])
        design = base.replace(
            involute=involute,
            cycloid=cycloid,
            cranks=CrankStage(cranks, case["radius"]),
            stiffness=base.stiffness.replace(**{name: case[name] for name in SPRINGS}),
            inertia=base.inertia.replace(**{name: case[name] for name in MASSES}),
            mesh_variation=base.mesh_variation.replace(**{name: case[name] for name in SWINGS}),
            damping=rvjax.Damping(loss_factor=case["loss"]),
        )
        names = ("output.x", "output.y", "output.rotation", "sun.rotation", "disc1.rotation")
        got = rvjax.dynamics.response(
            design, sun_speed=case["speed"], output_torque=case["torque"], stage=stage, harmonics=3, method=method,
            outputs=names,
        )  # fmt: skip
        scale = jnp.array([1, 1, 0.06, 0.01, 0.06], case["e"].dtype)  # m of every output
        size = jnp.max(jnp.abs(got.mean) * scale) + jnp.max(jnp.abs(got.amplitude) * scale)
        size = jnp.where(size > 0, size, 1)
        return dict(values=(got.amplitude * scale / size, got.mean * scale / size), status=got.info.status,
                    residual=got.info.residual, scale=jnp.ones(()))  # fmt: skip

    def judge(case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
        expected = np.where(nonfinite(case), Status.NONFINITE, -1)
        return expected, np.zeros(len(expected))

    return Model(
        f"dynamics {method} {stage} {cranks} cranks {discs} discs",
        draw,
        run,
        judge,
        relative_step,
        ordinary=lambda c: c["loss"] > 0.01,
    )
