"""Lost motion for the census, checked by the paper's sum and a search over the flank in 80-bit numbers."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.census.cases import REAL, Case, Model, decades, moderate, nonfinite, relative_step
from rvjax import RVErrors, RVReducer, lost_motion
from rvjax.designs import CrankStage, CycloidStage, InvoluteStage
from rvjax.errors import read_by
from rvjax.status import Status

PLAY = read_by(RVErrors, "lost_motion")
SCANNED = 150  # of a chunk; a search takes a millisecond


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
        f"lost_motion {profile}",
        f"lost_motion {profile} {teeth} teeth",
        draw,
        run,
        functools.partial(judge_play, profile, teeth),
        relative_step,
        ordinary=functools.partial(ordinary, teeth),
    )


def ordinary(teeth: int, case: Case) -> np.ndarray:
    """K1 below 0.9 and deviations below a tenth of the eccentricity."""
    e = case["e"]
    fit = (e * (teeth + 1) < 0.9 * case["rp"]) & moderate(case) & (e > 1e-9) & (np.abs(case["tilt"]) < 1.5)
    for name in (*PLAY, "equidistant", "shift"):
        fit &= np.abs(case[name]) < 0.1 * e
    return fit


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
            flank = np.full_like(K, np.nan)
            some = np.flatnonzero(possible & assembles & np.isfinite(K) & (status_of(out) == 0))[:SCANNED]
            flank[some] = 2 * scan(*(x[some] for x in (E, ring, ground, K, D, d)), teeth)
        total = rest + flank
    error = (
        np.nan_to_num(np.abs(out["values"] - total)) / out["scale"] * (1 - k1)
    )  # K1 is known to a rounding of e zp / rp
    expected = np.where(
        possible, np.where(assembles, Status.CONVERGED, Status.NOT_ASSEMBLABLE), Status.INVALID_GEOMETRY
    )
    if profile == "contact":  # deviations beyond the smallest radius of curvature may leave no flank or only its end
        none = np.isin(status_of(out), (Status.MAX_STEPS, Status.INVALID_GEOMETRY))
        unsure |= none & possible & ((np.abs(D) + np.abs(d)) / E > 1 - K)
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
