"""Shared by the tests of the mesh-force model: batches of units, one program per (teeth, contact), NumPy geometry."""

import functools

import jax
import numpy as np

import rvjax
from rvjax import CamRollerErrors, CamRollerReducer

DESIGN = ("cam_radius", "roller_radius", "roller_length", "eccentricity", "young_modulus", "poisson_ratio", "cam_share")
ERRORS = ("cam_radius", "eccentricity", "roller_radius")


@functools.cache
def program(teeth, contact):
    """jit(vmap(solve)) over flat dictionaries of arrays; roller radii (cases, rollers)."""
    return jax.jit(jax.vmap(functools.partial(single, teeth, contact)))


def single(teeth, contact, case):
    design = CamRollerReducer(gear_teeth=teeth, **{name: case[name] for name in DESIGN})
    errors = CamRollerErrors(**{name: case["errors." + name] for name in ERRORS})
    return rvjax.mesh_force.solve(
        design, errors, input_torque=case["torque"], output_angle=case["angle"], contact=contact
    )


def solve(teeth, cases, contact="hertz"):
    """Solve a batch (dictionary of arrays), 512 at a time, the last ones padded, so that programs are shared."""
    count, size = len(cases["torque"]), 512
    parts = []
    for first in range(0, count, size):
        index = np.minimum(first + np.arange(size), count - 1)
        part = program(teeth, contact)({name: v[index] for name, v in cases.items()})
        parts.append(jax.tree.map(lambda leaf, left=count - first: np.asarray(leaf)[:left], part))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def corr(count, teeth=25, **changes):
    """`count` units of the published stage, without errors, at 100 N m and 0.0013 rad."""
    stage = rvjax.catalogue.CORR
    cases = {name: np.full(count, getattr(stage, name)) for name in DESIGN}
    cases |= {"errors." + name: np.zeros(count) for name in ERRORS[:2]}
    cases |= {"errors.roller_radius": np.zeros((count, teeth + 1))}
    cases |= {"torque": np.full(count, 100.0), "angle": np.full(count, 0.0013)}
    for name, value in changes.items():
        name = name.replace("errors_", "errors.")
        cases[name] = np.broadcast_to(value, cases[name].shape).astype(float)
    return cases


def random_units(teeth, count, rng, *, nearness=0.98, torque=(-5, 4), error=(-8, -4), share_with_errors=0.5):
    """Designs up to `nearness` of the undercut limit, torques and errors over decades, any angle."""
    cam = rng.uniform(0.02, 0.3, count)
    roller = cam * rng.uniform(0.02, 0.3, count)
    link = cam + roller
    limit = np.minimum(link * (link + roller) / (link + roller * teeth**2), 0.9 * link)
    size = 10 ** rng.uniform(*error, count) * (rng.uniform(size=count) < share_with_errors)
    return {
        "cam_radius": cam,
        "roller_radius": roller,
        "roller_length": roller * rng.uniform(0.5, 4, count),
        "eccentricity": limit * rng.uniform(0.02, nearness, count),
        "young_modulus": 10 ** rng.uniform(9, 11.5, count),
        "poisson_ratio": rng.uniform(0, 0.49, count),
        "cam_share": rng.uniform(0.5, 0.6, count),
        "errors.cam_radius": size * rng.normal(size=count),
        "errors.eccentricity": size * rng.normal(size=count),
        "errors.roller_radius": size[:, None] * rng.normal(size=(count, teeth + 1)),
        "torque": 10 ** rng.uniform(*torque, count) * rng.choice([-1, 1], count),
        "angle": rng.uniform(-7, 7, count),
    }


def geometry(teeth, cases):
    """Geometry in the words of the paper, (cases, rollers): gamma, beta, s, arm a, kw, and interference g."""
    column = {name: v[:, None] if v.ndim == 1 else v for name, v in cases.items()}
    e, r, cam = column["eccentricity"], column["roller_radius"], column["cam_radius"]
    link, z = cam + r, teeth
    psi = np.remainder(z * column["angle"], 2 * np.pi) - 2 * np.pi * np.arange(z + 1) / (z + 1)
    gamma = np.arcsin(e / link * np.sin(psi))
    beta = np.arctan(z * np.tan(gamma))
    s = e * np.cos(psi) + link * np.cos(gamma)
    # curvature of the centre curve r(theta) = s from its derivatives by psi = z theta
    slope_gamma = e / link * np.cos(psi) / np.cos(gamma)
    first = z * (-e * np.sin(psi) - link * np.sin(gamma) * slope_gamma)
    bend_gamma = (-e / link * np.sin(psi) + np.sin(gamma) * slope_gamma**2) / np.cos(gamma)
    second = z**2 * (-e * np.cos(psi) - link * (np.cos(gamma) * slope_gamma**2 + np.sin(gamma) * bend_gamma))
    kc = (s**2 + 2 * first**2 - s * second) / (s**2 + first**2) ** 1.5
    gear_ratio = np.cos(gamma) / np.cos(beta)
    cage_ratio = np.sin(gamma) + np.tan(beta) * np.cos(gamma)
    return {
        "psi": psi,
        "gamma": gamma,
        "beta": beta,
        "s": s,
        "arm": e * np.sin(psi + gamma),
        "kc": kc,
        "cage_ratio": cage_ratio,
        "gear_ratio": gear_ratio,
        "gap": column["errors.cam_radius"]
        + column["errors.eccentricity"] * np.cos(psi + gamma)
        + column["errors.roller_radius"] * (1 + np.abs(cage_ratio) + gear_ratio),
    }


def half_widths(teeth, cases, forces):
    """b over the smaller radius at cam, cage and gear, (cases, rollers, 3); 1 is the contact limit."""
    column = {name: v[:, None] for name, v in cases.items() if v.ndim == 1}
    place = geometry(teeth, cases)
    r, cam = column["roller_radius"], column["cam_radius"]
    modulus = 2 * (1 - column["poisson_ratio"] ** 2) / column["young_modulus"]
    relative = (r * cam / (r + cam), r, r * (1 + r * place["kc"]))
    curvature = (1 / cam, 0, np.abs(place["kc"] / (1 + r * place["kc"])))
    shares = []
    for force, radius, bend in zip((forces.cam, np.abs(forces.cage), forces.gear), relative, curvature):
        width = np.sqrt(4 * force * radius * modulus / (np.pi * column["roller_length"]))
        shares.append(width * np.maximum(1 / r, bend))
    return np.stack(shares, -1)


def approach(teeth, cases, forces, contact):
    """Approach along the cam normal from the forces, Eqs. 9-15 in the paper's terms, (cases, rollers)."""
    column = {name: v[:, None] for name, v in cases.items() if v.ndim == 1}
    place = geometry(teeth, cases)
    r, cam, length = column["roller_radius"], column["cam_radius"], column["roller_length"]
    modulus = 2 * (1 - column["poisson_ratio"] ** 2) / column["young_modulus"]
    total = 0.0
    sides = (
        (forces.cam, 1.0, r * cam / (r + cam), -1 / cam),
        (np.abs(forces.cage), np.abs(place["cage_ratio"]), r, 0.0),
        (forces.gear, place["gear_ratio"], r * (1 + r * place["kc"]), place["kc"] / (1 + r * place["kc"])),
    )
    for force, weight, radius, curvature in sides:
        if contact == "linear":
            depth = 2 * force * modulus / (np.pi * length)
        elif contact == "palmgren":
            depth = 3.81 * (modulus * force / np.pi) ** 0.9 / length**0.8
        else:
            square = 4 * force * radius * modulus / (np.pi * length)
            depth = square / (r + np.sqrt(r**2 - square)) - curvature * square / (
                1 + np.sqrt(1 - curvature**2 * square)
            )
        total = total + weight * depth
    return total
