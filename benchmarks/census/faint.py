"""Torques far below any that a bench measures: `python -m benchmarks.census.faint [--each 450]`.

Counts reducers under random torques of 1e-12 to 1e-3 N m by status, and those CONVERGED with a residual above the
bound. A status of the loaded reducer is a promise there too: 0 are allowed.
"""

import argparse
import json
from typing import Any

import jax
import numpy as np

from benchmarks.census.cases import Case
from benchmarks.census.loaded import draw, error_shapes, run
from rvjax import catalogue
from rvjax.status import Status

BOUND = 1.5e-8  # of the residual of a converged case, relative to the largest force
TEETH = ("sun_teeth", "planet_teeth")
DECADES = (-12.0, -3.0)
FIXED, AFLOAT = dict(carrier="fixed", sun="fixed"), dict(carrier="floating", sun="floating")
LAYOUTS = {
    "3 discs, 5 cranks, 4 pins": dict(contact="palmgren", cranks=5, discs=3, teeth=3, **FIXED),
    "2 discs, 3 cranks, 9 pins": dict(contact="palmgren", cranks=3, discs=2, teeth=8, **FIXED),
    "2 discs, 2 cranks, 40 pins, floating": dict(contact="palmgren", cranks=2, discs=2, teeth=39, **AFLOAT),
}


def reducers(seed: int, lanes: int, layout: dict[str, Any], decades: tuple[float, float]) -> Case:
    """Steel reducers of one size, errors of 0.1 to 10 um in four of five, torques of 10^`decades` N m."""
    rng = np.random.default_rng(seed)
    case = draw(rng, lanes, **layout, given=False)
    involute = catalogue.RV_40E.involute
    base = 0.036 * np.cos(0.35) / sum(getattr(involute, name) for name in TEETH)
    fixed = dict(
        pin_circle_radius_of_design=0.06, pin_radius_of_design=0.003, circle_radius=0.036, pressure_angle=0.35,
        young_modulus=2e11, poisson_ratio=0.3, face_width=0.01, planet_crank_torsion=1e6,
        sun_base_radius=base * involute.sun_teeth, planet_base_radius=base * involute.planet_teeth,
    )  # fmt: skip
    case |= {name: np.full(case[name].shape, value) for name, value in fixed.items()}
    case["eccentricity_of_design"] = rng.uniform(0.3, 0.8, lanes) * 0.06 / (layout["teeth"] + 1)
    for name in ("turning_arm_bearing", "support_bearing", "sun_planet_mesh", "planet_crank_bending"):
        size = (lanes,) + (1,) * (case[name].ndim - 1)
        case[name] = 10 ** rng.uniform(7.5, 9, size) * rng.uniform(0.9, 1.1, case[name].shape)
    flawed = rng.uniform(size=lanes) > 0.2
    for name, shape in error_shapes(layout["cranks"], layout["discs"], layout["teeth"]).items():
        size = 10 ** rng.uniform(-7, -5, lanes) * flawed * (100 if name == "crank_phase" else 1)
        case[name] = size.reshape((lanes,) + (1,) * len(shape)) * rng.normal(size=(lanes, *shape))
    for name in ("bearing_clearance", "support_clearance"):
        case[name] = np.abs(case[name])
    case["torque"] = 10 ** rng.uniform(*decades, lanes) * rng.choice([-1, 1], lanes)
    return case | {"angle": rng.uniform(-700, 700, lanes)}


def counted(name: str, each: int, seed: int = 0) -> dict[str, Any]:
    """Counts of one layout: by status, and CONVERGED above the bound."""
    layout = LAYOUTS[name]
    case = reducers(seed, each, layout, DECADES)
    out = jax.tree.map(np.asarray, jax.jit(jax.vmap(lambda one: run(one, **layout, given=False)))(case))
    good = out["status"] == Status.CONVERGED
    codes, many = np.unique(out["status"], return_counts=True)
    residual = np.where(good, np.abs(out["residual"]), 0.0)
    return {
        "statuses": {Status(int(code)).name: int(count) for code, count in zip(codes, many)},
        "largest residual": float(residual.max()),
        "converged above the bound": int((residual > BOUND).sum()),
        "torques": [float(t) for t in np.abs(case["torque"][residual > BOUND])],
    }


def main() -> None:
    """Print the counts of every layout."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--each", type=int, default=450, help="reducers of a layout")
    parser.add_argument("--layout", choices=LAYOUTS, action="append")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for name in options.layout or LAYOUTS:
        print(name, json.dumps(counted(name, options.each)), flush=True)


if __name__ == "__main__":
    main()
