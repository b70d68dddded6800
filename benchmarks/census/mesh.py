"""The roller stage for the census: draws to the undercut limit and beyond, checked by statics from the forces."""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

import rvjax
from benchmarks.census.cases import Case, Model, relative_step
from rvjax.status import Status

DESIGN = ("cam_radius", "roller_radius", "roller_length", "eccentricity", "young_modulus", "poisson_ratio", "cam_share")


def mesh(contact: str, teeth: int) -> Model:
    return Model(
        f"mesh_force {contact}",
        f"mesh_force {contact} {teeth} teeth",
        functools.partial(draw, teeth=teeth),
        functools.partial(run, contact, teeth),
        functools.partial(judge, contact, teeth),
        relative_step,
        ordinary=functools.partial(ordinary, teeth),
        judged=min(1.0, 13 / (teeth + 1)),
        faint=1e-6 if contact == "palmgren" else 0.0,  # its stiffness goes to zero with the ninth root of the depth
    )


def draw(rng: Any, size: int, teeth: int) -> Case:
    """Designs up to and beyond undercut, torques over nine decades and none, interference up to the roller itself."""
    cam = 10 ** rng.uniform(-3, 0.5, size)
    roller = cam * 10 ** rng.uniform(-2.5, -0.3, size)
    link = cam + roller
    limit = np.minimum(link * (link + roller) / (link + roller * teeth**2), 0.95 * link)
    near = 1 - 10 ** rng.uniform(-12, -2, size) * rng.choice([-1, 1], size)
    part = np.where(rng.uniform(size=size) < 0.1, near, 10 ** rng.uniform(-4, 0.02, size))
    modulus, length = 10 ** rng.uniform(9, 11.5, size), roller * 10 ** rng.uniform(-0.5, 0.7, size)
    # Torques and errors around those that bring a half-width to the roller radius, and down from there.
    strong = modulus * length * roller * limit * part * teeth
    torque = 10 ** rng.uniform(-9, 0.3, size) * strong * rng.choice([-1, 1], size) * (rng.uniform(size=size) > 0.05)
    error = roller * 10 ** rng.uniform(-10, 0, size) * (rng.uniform(size=size) > 0.25)
    turn = rng.integers(-4 * teeth, 4 * teeth, size) * np.pi / (teeth * (teeth + 1))
    angle = np.where(rng.uniform(size=size) < 0.3, turn, rng.uniform(-7, 7, size))
    many = rng.uniform(size=(size, teeth + 1)) < np.where(rng.uniform(size=size) < 0.2, 1 / teeth, 1)[:, None]
    return {
        "cam_radius": cam,
        "roller_radius": roller,
        "roller_length": length,
        "eccentricity": limit * part,
        "young_modulus": modulus,
        "poisson_ratio": rng.uniform(-0.5, 0.49, size),
        "cam_share": rng.uniform(0.5, 0.6, size),
        "error_cam": error * rng.normal(size=size) * (rng.uniform(size=size) > 0.5),
        "error_throw": error * rng.normal(size=size) * (rng.uniform(size=size) > 0.5),
        "error_rollers": error[:, None] * rng.normal(size=(size, teeth + 1)) * many,
        "torque": torque,
        "angle": np.where(rng.uniform(size=size) < 0.03, 0, angle),
    }


def run(contact: str, teeth: int, case: Case) -> dict[str, Any]:
    design = rvjax.CamRollerReducer(gear_teeth=teeth, **{name: case[name] for name in DESIGN})
    errors = rvjax.CamRollerErrors(case["error_cam"], case["error_throw"], case["error_rollers"])
    got = rvjax.mesh_force.solve(
        design, errors, input_torque=case["torque"], output_angle=case["angle"], contact=contact
    )
    largest = jnp.max(jnp.abs(got.gear))
    return dict(
        values=(got.cam, got.cage, got.gear),
        status=got.info.status,
        residual=got.info.residual,
        scale=jnp.where(largest > 0, largest, 1),
        windup=got.windup,
    )


def geometry(teeth: int, case: Case) -> Case:
    """In 80-bit numbers, the words of the paper; (cases, rollers)."""
    c = {k: v.astype(np.longdouble)[:, None] if v.ndim == 1 else v.astype(np.longdouble) for k, v in case.items()}
    e, r, cam = c["eccentricity"], c["roller_radius"], c["cam_radius"]
    link, pi = cam + r, np.longdouble("3.14159265358979323846264338327950288")
    psi = teeth * c["angle"] - 2 * pi * np.arange(teeth + 1) / (teeth + 1)
    gamma = np.arcsin(e / link * np.sin(psi))
    beta = np.arctan2(teeth * np.sin(gamma), np.cos(gamma))
    s, q = e * np.cos(psi) + link * np.cos(gamma), np.cos(gamma) ** 2 + teeth**2 * np.sin(gamma) ** 2
    bend = np.cos(gamma) / (s * np.sqrt(q)) * (1 + teeth**2 * e / link * np.cos(psi) / (np.cos(gamma) * q))
    cage, gear = (teeth + 1) * np.sin(gamma), np.sqrt(q)
    gap = c["error_cam"] + c["error_throw"] * np.cos(psi + gamma) + c["error_rollers"] * (1 + np.abs(cage) + gear)
    stiff = 2 * (1 - c["poisson_ratio"] ** 2) / c["young_modulus"]
    return dict(c, arm=e * np.sin(psi + gamma), cage=cage, gear=gear, bend=bend, gap=gap, stiff=stiff, beta=beta)


def widths_and_approach(g: Case, force: Any, contact: str) -> tuple[Any, Any]:
    """Largest half-width over the radius it may not reach, and the approach along the cam normal."""
    r, cam, length = g["roller_radius"], g["cam_radius"], g["roller_length"]
    widest, total = np.zeros_like(force), np.zeros_like(force)
    one = np.ones_like(force)
    for weight, radius, k in (
        (one, r * cam / (r + cam), -one / cam),
        (np.abs(g["cage"]), r * one, 0 * one),
        (g["gear"], r * (1 + r * g["bend"]), g["bend"] / (1 + r * g["bend"])),
    ):
        part = weight * force
        square = 4 * part * radius * g["stiff"] / (np.pi * length)
        widest = np.maximum(widest, np.sqrt(square) * np.maximum(1 / r, np.abs(k)))
        if contact == "linear":
            depth = 2 * part * g["stiff"] / (np.pi * length)
        elif contact == "palmgren":
            depth = 3.81 * (g["stiff"] * part / np.pi) ** np.longdouble(0.9) / length ** np.longdouble(0.8)
        else:
            depth = square / (r + np.sqrt(r**2 - square)) - k * square / (1 + np.sqrt(1 - k**2 * square))
        total = total + weight * depth
    return widest, total


def judge(contact: str, teeth: int, case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
    """Statics and compatibility from the returned forces; overload from an own search where it is claimed."""
    cam, windup, status = out["values"][0], out["windup"], out["status"]
    g = geometry(teeth, case)
    torque = (case["cam_share"] * case["torque"]).astype(np.longdouble)
    moments = g["arm"] * cam
    size = np.maximum(np.abs(torque), np.abs(moments).sum(1))
    size = np.maximum(size, 1e-3 * case["eccentricity"] * cam.max(1))  # dead-centre rollers alone have no moment
    error = np.abs(moments.sum(1) - torque) / np.where(size > 0, size, 1)
    widest, approach = widths_and_approach(g, cam.astype(np.longdouble), contact)
    depth = windup[:, None] * g["arm"] + g["gap"]
    span = np.maximum(np.abs(depth).max(1), np.abs(windup * g["eccentricity"][:, 0]))[:, None]
    off = np.where(cam > 0, np.abs(approach - depth), np.maximum(depth, 0)) / np.where(span > 0, span, 1)
    idle = (status == Status.UNLOADED)[:, None]
    off = np.where(idle, np.maximum(depth, 0) / np.where(span > 0, span, 1), off)
    error = np.maximum(error, off.max(1))
    link = (case["cam_radius"] + case["roller_radius"]).astype(np.longdouble)
    e = case["eccentricity"].astype(np.longdouble)
    possible = (
        np.all([case[name] > 0 for name in DESIGN[:5]], axis=0) & (np.abs(case["poisson_ratio"]) < 1) & (e < link)
    )
    margin = 1 + case["roller_radius"] * (1 - teeth**2 * e / link) / (link - e)
    expected = np.where(margin <= 0, Status.UNDERCUT, -1)
    sure = np.abs(margin) > 1e-12
    preload = (torque == 0) & dead_band(g)
    whole = possible & (margin > 0) & moderate(case)
    expected = np.where(whole & preload, Status.UNLOADED, expected)
    if contact != "hertz":
        expected = np.where(whole & ~preload & (torque != 0), Status.CONVERGED, expected)
    else:
        over = np.array(status == Status.CONTACT_OVERLOAD)
        lanes = np.flatnonzero((over | (status == Status.CONVERGED)) & whole & ~preload)
        if len(lanes):
            lanes = np.concatenate([lanes[over[lanes]][:40], lanes[~over[lanes]][:10]])
            part = {k: v[lanes] if len(np.shape(v)) and len(v) == len(status) else v for k, v in g.items()}
            tells = overloaded(part, torque[lanes])
            expected[lanes] = np.where(tells > 0, Status.CONTACT_OVERLOAD, np.where(tells < 0, Status.CONVERGED, -1))
        error = np.where((status == Status.CONVERGED) & (widest.max(1) >= 1 + 1e-9), np.inf, error)
    expected = np.where(possible, expected, Status.INVALID_GEOMETRY)
    expected = np.where(sure | ~possible, expected, -1)
    expected = np.where(
        ~np.all([np.isfinite(v.reshape(len(v), -1)).all(1) for v in case.values()], axis=0), Status.NONFINITE, expected
    )
    tiny = np.any([np.abs(case[name]) < 1e-20 for name in DESIGN[:5]], axis=0)
    tiny |= (torque != 0) & (np.abs(torque) < 1e-100)  # squares of the loads underflow
    # A torque below what the rounding of the gaps carries may or may not be found: MAX_STEPS is a reason then.
    stiff = case["young_modulus"] * case["roller_length"] * case["eccentricity"]
    drowned = (torque != 0) & (np.abs(torque) < 1e-15 * np.abs(g["gap"]).max(1) * stiff)
    expected = np.where(drowned & (status == Status.MAX_STEPS), -1, expected)
    trusted = moderate(case) & ~tiny
    expected = np.where(trusted | (expected == Status.NONFINITE) | (expected == Status.INVALID_GEOMETRY), expected, -1)
    return expected, np.where(trusted, error, 0).astype(float)


def moderate(case: Case) -> np.ndarray:
    return np.all([(np.abs(v.reshape(len(v), -1)) < 1e25).all(1) for v in case.values()], axis=0)


def dead_band(g: Case) -> np.ndarray:
    """True if some windup leaves every roller without load, with a margin."""
    edge = -g["gap"] / np.where(g["arm"] == 0, 1, g["arm"])
    ahead, behind = g["arm"] > 1e-6 * g["eccentricity"], g["arm"] < -1e-6 * g["eccentricity"]
    upper, lower = np.where(ahead, edge, np.inf).min(1), np.where(behind, edge, -np.inf).max(1)
    dead = np.where(ahead | behind, 0, np.maximum(g["gap"], 0)).max(1)
    return (lower < upper - 1e-12 * np.abs(upper)) & (dead <= 0) | (np.abs(g["gap"]).max(1) == 0)


def overloaded(g: Case, torque: Any) -> np.ndarray:
    """1 where the equilibrium passes a limit, -1 where it does not, 0 where that is too close to decide: bisection."""
    lanes = len(torque)

    def loads(windup: Any) -> tuple[Any, Any]:
        depth = np.maximum(windup[:, None] * g["arm"] + g["gap"], 0)
        high = np.full_like(depth, 0)
        low = np.zeros_like(depth)
        limit = np.ones_like(depth)
        for weight, radius, k in (
            (1.0, g["roller_radius"] * g["cam_radius"] / (g["roller_radius"] + g["cam_radius"]), 1 / g["cam_radius"]),
            (np.abs(g["cage"]), g["roller_radius"] + 0 * depth, 0 * depth),
            (
                g["gear"],
                g["roller_radius"] * (1 + g["roller_radius"] * g["bend"]),
                np.abs(g["bend"] / (1 + g["roller_radius"] * g["bend"])),
            ),
        ):
            slope = 4 * weight * radius * g["stiff"] / (np.pi * g["roller_length"])
            most = 1 / (slope * np.maximum(1 / g["roller_radius"], k) ** 2)
            limit = (
                np.where(high == 0, most, np.minimum(limit, most)) if np.isscalar(weight) else np.minimum(limit, most)
            )
        high = limit * (1 - 1e-12)
        _, last = widths_and_approach(g, high, "hertz")
        beyond = depth > last
        top = high.copy()
        for _ in range(60):
            middle = (low + high) / 2
            below = widths_and_approach(g, middle, "hertz")[1] < depth
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        stiffness = 1 / (2 * g["stiff"] / (np.pi * g["roller_length"]) * (1 + g["cage"] ** 2 + g["gear"] ** 2))
        return np.where(beyond, top + stiffness * (depth - last), np.where(depth > 0, low, 0)), beyond

    span = (np.abs(g["gap"]).max(1) + 10 * g["roller_radius"][:, 0]) / (1e-3 * g["eccentricity"][:, 0])
    low, high = -span, span
    for _ in range(70):
        middle = (low + high) / 2
        force, _ = loads(middle)
        short = (g["arm"] * force).sum(1) < torque
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    closed = np.isfinite(low) & (np.abs(low) < span * (1 - 1e-9))
    first = loads(low - 1e-7 * np.abs(low))[1].any(1)
    second = loads(high + 1e-7 * np.abs(high))[1].any(1)
    at = loads((low + high) / 2)[1].any(1)
    sure = closed & (first == at) & (second == at)
    return np.where(sure, np.where(at, 1, -1), 0).reshape(lanes)


def ordinary(teeth: int, case: Case) -> np.ndarray:
    """Cases with a bound in single precision: gaps of at most a hundred elastic approaches, z theta up to 150 rad."""
    stiff = case["young_modulus"] * case["roller_length"]
    elastic = np.abs(case["torque"]) / (case["eccentricity"] * stiff * teeth)
    gap = np.abs(case["error_cam"]) + np.abs(case["error_throw"]) + np.abs(case["error_rollers"]).max(1) * teeth
    fit = case["eccentricity"] < 0.9 * (case["cam_radius"] + case["roller_radius"])
    return fit & (gap <= 10 * elastic) & (np.abs(teeth * case["angle"]) <= 150)
