"""The dynamic transmission error for the census, checked by the springs of all parts, displaced angle by angle.

The reference uses no signals and orders: `tests.oracles.dynamic_error` gives the material place of every spring at
every angle of a turn of the output; the Fourier coefficients of the forces meet the dense equations of motion.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np

import rvjax
from benchmarks.census.cases import Case, Model, decades, deviations, nonfinite, relative_step
from benchmarks.census.dynamics import JUDGED, SWINGS, build_reducer, draw_reducer, ordinary, physical
from rvjax import RVErrors
from rvjax.status import Status
from tests.oracles.dynamic_error import Marched
from tests.oracles.dynamics import Oracle

OUTPUTS, SHOWN = ("output.rotation", "sun.rotation"), [-1, 2]
SCALE = np.array([1.0, 1e-2])  # a revolution of the sun, and of the output: where the sun is free, it takes the error
READ = ("torque", *SWINGS)  # of the reducers of the census, what errors as excitation do not read


def displaced(cranks: int, discs: int) -> Model:
    """Lines of random reducers with random errors of all parts but single pins."""
    shapes = {
        "sun_runout": (2,), "planet_runout": (cranks, 2), "sun_flank": (cranks, 2), "planet_flank": (cranks, 1, 2),
        "crank_eccentricity": (discs, cranks), "crank_phase": (cranks,), "carrier_bore": (cranks, 2),
        "disc_bore": (discs, cranks, 2), "disc_centre": (discs, 2), "disc_flank": (discs, 2, 2), "ring_centre": (2,),
        "ring_flank": (discs, 2),
    }  # fmt: skip

    def draw(rng: Any, size: int) -> Case:
        case = {name: value for name, value in draw_reducer(rng, size).items() if name not in READ}
        part = {name: np.ones(size) if name == "crank_phase" else case["e"] for name in shapes}
        case |= {name: deviations(rng, (size, *shape), part[name]) for name, shape in shapes.items()}
        return case | dict(load=decades(rng, size, -4, 4) * (rng.uniform(size=size) > 0.3))

    def build(case: Case) -> rvjax.RVReducer:
        none = np.zeros_like(case["e"]) if isinstance(case["e"], np.ndarray) else 0.0
        return build_reducer({**case, **dict.fromkeys(READ, none)}, cranks, discs)

    def run(case: Case) -> dict[str, Any]:
        errors = RVErrors(**{name: case[name] for name in shapes})
        got = rvjax.dynamics.transmission_error(
            *(build(case), errors), sun_speed=case["speed"], load_inertia=case["load"], outputs=OUTPUTS
        )
        scale = jnp.asarray(SCALE, case["e"].dtype)[None]
        amplitude, static = got.amplitude * scale, got.static * scale
        size = jnp.max(jnp.abs(amplitude)) + jnp.max(jnp.abs(static))
        size = jnp.where(size > 0, size, 1)
        shown = dict(values=(amplitude / size, static / size), windup=(got.peak_to_peak, got.frequency))
        info = dict(status=got.info.status, residual=got.info.residual)
        return shown | info | dict(scale=jnp.ones(()), order=got.order)

    def judge(case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
        status = np.asarray(out["status"])
        error = np.zeros(len(status))
        expected = np.where(nonfinite(case), Status.NONFINITE, -1)
        whole = physical(case, status) & (case["loss"] >= 0) & (case["loss"] < 1) & (case["load"] >= 0)
        for lane in np.flatnonzero(whole)[:JUDGED]:
            expected[lane], error[lane] = compare(case, out, lane)
        return expected, error

    def compare(case: Case, out: Any, lane: int) -> tuple[int, float]:
        one = {name: value[lane] if value[lane].ndim else float(value[lane]) for name, value in case.items()}
        design = build(one)
        inertia, stiffness = design.inertia, design.stiffness
        supports = {name: one[name] or 1e7 for name in ("sun_support", "output_support")}  # rotations do not feel them
        design = design.replace(
            inertia=inertia.replace(output_inertia=inertia.output_inertia + one["load"]),
            stiffness=stiffness.replace(**supports),
        )
        oracle, held = Oracle(design), one["sun_torsion"] > 0 or one["output_torsion"] > 0
        scale = 1 / np.sqrt(np.diag(oracle.K))
        ground = oracle.K.copy()
        if not held:
            ground[2, 2] += one["sun_planet_mesh"] * one["sun_base"] ** 2  # at standstill the sun stays
        least = np.linalg.eigvalsh(scale[:, None] * ground * scale)[0]
        if least < 1e-10 or one["loss"] < 0.01:
            return -1, 0.0
        if not held and one["speed"] == 0:
            return int(Status.SINGULAR), 0.0
        order = np.asarray(out["order"])[lane]
        forces = pulled(design, {name: one[name] for name in shapes}, order)
        damped = 1 + 1j * one["loss"] * np.sign(one["speed"] or 1.0)
        due = []
        for n, force in zip(order, forces):
            w = n * one["speed"] / design.ratio
            due.append(np.linalg.solve(oracle.K * damped - w**2 * np.diag(oracle.m), damped * force)[SHOWN])
        still = [np.linalg.solve(ground, force)[SHOWN] for force in forces]
        amplitude, static = np.array(due) * SCALE, np.array(still) * SCALE
        size = np.abs(amplitude).max() + np.abs(static).max() or 1.0
        found, rest = (np.asarray(value)[lane] for value in out["values"])
        off = max(np.abs(found - amplitude / size).max(), np.abs(rest - static / size).max())
        return int(Status.CONVERGED), float(off) if size != 1.0 else 0.0

    def plain(case: Case) -> np.ndarray:
        return ordinary({name: value for name, value in case.items() if name not in shapes})

    name = f"dynamics errors {cranks} cranks {discs} discs"
    return Model("dynamics errors", name, draw, run, judge, relative_step, ordinary=plain)


def pulled(design: rvjax.RVReducer, errors: dict[str, np.ndarray], order: np.ndarray) -> np.ndarray:
    """Forces that the errors put on all coordinates (orders, n), complex: k delta along every spring, over a turn.

    Angles are enough for the highest order met, and the turn for those that are whole numbers.
    """
    parts = Marched(design, errors)
    angles = 2 * np.pi * np.arange(2 * int(order.max()) + 64) / (2 * int(order.max()) + 64)
    force = np.zeros((len(angles), parts.n))
    for place, theta in enumerate(angles):
        turn = parts.pins * theta
        rows = parts.middle + np.cos(turn) * parts.cosine + np.sin(turn) * parts.sine
        force[place] = rows.T @ (parts.k * parts.displaced(theta))
    return 2 * np.exp(-1j * np.outer(order, angles)) @ force / len(angles)
