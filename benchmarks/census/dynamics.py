"""The dynamic model for the census, checked by equations of motion that NumPy puts together and solves."""

from typing import Any

import jax.numpy as jnp
import numpy as np

import rvjax
from benchmarks.census.cases import Case, Model, decades, moderate, nonfinite, relative_step
from rvjax import catalogue
from rvjax.designs import CrankStage
from rvjax.status import Status
from tests.oracles.dynamics import Oracle

SPRINGS = ("sun_support", "sun_torsion", "planet_crank_bending", "planet_crank_torsion", "support_bearing",
           "turning_arm_bearing", "sun_planet_mesh", "disc_pin_mesh", "output_support", "output_torsion")  # fmt: skip
MASSES = ("sun_mass", "sun_inertia", "planet_mass", "planet_inertia", "crank_mass", "crank_inertia", "disc_mass",
          "disc_inertia", "output_mass", "output_inertia")  # fmt: skip
OUTPUTS = ("output.x", "output.y", "output.rotation", "sun.rotation", "disc1.rotation")
ARMS = (1.0, 1.0, 0.06, 0.01, 0.06)  # m, that rotations compare with translations
HARMONICS = 3
BASE = catalogue.RV_320E
JUDGED = 20  # of a chunk; the oracle takes milliseconds
SWINGS = ("planetary_swing", "planetary_duty", "cycloid_swing", "cycloid_duty")


def ordinary(case: Case) -> np.ndarray:
    """Damped, held against rotation, and no number of next to nothing: float32 would drop its square."""
    sizes = [np.abs(value) for value in case.values()]
    held = case["sun_torsion"] + case["output_torsion"] > 0
    return (case["loss"] > 0.02) & held & moderate(case, 1e15) & np.all([(x == 0) | (x > 1e-8) for x in sizes], axis=0)


def draw_reducer(rng: Any, size: int) -> Case:
    def around(value: float, spread: float = 1.0) -> np.ndarray:
        return value * decades(rng, size, -spread, spread)

    case = {name: around(getattr(BASE.stiffness, name) or 1e7) for name in SPRINGS}
    for name in ("sun_support", "sun_torsion", "output_support", "output_torsion"):
        case[name] *= rng.uniform(size=size) > 0.3
    case |= {name: around(getattr(BASE.inertia, name)) for name in MASSES}
    case |= {name: rng.uniform(0, 0.9, size) * (rng.uniform(size=size) > 0.05) for name in SWINGS}
    speed = decades(rng, size, -3, 4) * rng.choice([-1, 1], size) * (rng.uniform(size=size) > 0.02)
    torque = decades(rng, size, -4, 5) * rng.choice([-1, 0, 1], size)
    case |= dict(e=around(2.2e-3), radius=around(0.0635), sun_base=around(0.01), planet_base=around(0.05))
    case |= dict(force_angle=rng.uniform(-1.4, 1.4, size), alpha=rng.uniform(0.1, 0.6, size))
    return case | dict(loss=decades(rng, size, -4, -0.5), speed=speed, torque=torque)


def build_reducer(case: Case, cranks: int, discs: int) -> rvjax.RVReducer:
    involute = BASE.involute.replace(
        sun_base_radius=case["sun_base"], planet_base_radius=case["planet_base"], pressure_angle=case["alpha"]
    )
    cycloid = BASE.cycloid.replace(  # the pin circle is not read; a large one leaves any eccentricity possible
        disc_count=discs, eccentricity=case["e"], force_angle=case["force_angle"], pin_circle_radius=100.0
    )
    return BASE.replace(
        involute=involute,
        cycloid=cycloid,
        cranks=CrankStage(cranks, case["radius"]),
        stiffness=BASE.stiffness.replace(**{name: case[name] for name in SPRINGS}),
        inertia=BASE.inertia.replace(**{name: case[name] for name in MASSES}),
        mesh_variation=BASE.mesh_variation.replace(**{name: case[name] for name in SWINGS}),
        damping=rvjax.Damping(loss_factor=case["loss"]),
    )


def physical(case: Case, status: np.ndarray) -> np.ndarray:
    """Batch elements that the reference solves: parts with mass and springs, sizes that 64 bits resolve, a solution."""
    positive = [case[name] > 0 for name in (*SPRINGS[2:8], *MASSES, "e", "radius", "sun_base", "planet_base")]
    whole = np.all(positive, axis=0) & moderate(case, 1e15) & (np.min([case[n] for n in MASSES], axis=0) > 1e-12)
    whole &= np.all([case[name] >= 0 for name in SPRINGS], axis=0) & np.isin(status, (0, Status.SINGULAR))
    whole &= (np.abs(case["force_angle"]) < 1.5) & (case["alpha"] > 0) & (case["alpha"] < 1.5)
    return whole & (case["e"] > 1e-9)


def vibration(stage: str, cranks: int, discs: int, method: str) -> Model:
    def build(case: Case) -> rvjax.RVReducer:
        return build_reducer(case, cranks, discs)

    def run(case: Case) -> dict[str, Any]:
        got = rvjax.dynamics.response(
            build(case), sun_speed=case["speed"], output_torque=case["torque"], stage=stage, harmonics=HARMONICS,
            method=method, outputs=OUTPUTS,
        )  # fmt: skip
        scale = jnp.array(ARMS, case["e"].dtype)
        size = jnp.max(jnp.abs(got.mean) * scale) + jnp.max(jnp.abs(got.amplitude) * scale[None])
        size = jnp.where(size > 0, size, 1)
        return dict(values=(got.amplitude * scale[None] / size, got.mean * scale / size), status=got.info.status,
                    residual=got.info.residual, scale=jnp.ones(()))  # fmt: skip

    def judge(case: Case, out: Any) -> tuple[np.ndarray, np.ndarray]:
        status = np.asarray(out["status"])
        error = np.zeros(len(status))
        expected = np.where(nonfinite(case), Status.NONFINITE, -1)
        whole = physical(case, status)
        whole &= np.all([(case[name] >= 0) & (case[name] < 1) for name in (*SWINGS, "loss")], axis=0)
        for lane in np.flatnonzero(whole)[:JUDGED]:
            expected[lane], error[lane] = compare(case, out, lane)
        return expected, error

    def compare(case: Case, out: Any, lane: int) -> tuple[int, float]:
        one = {name: float(value[lane]) for name, value in case.items()}
        oracle = Oracle(build(one))
        names = rvjax.dynamics.assemble(build(one)).labels
        rows = [names.index(name) for name in OUTPUTS]
        w, torque = oracle.frequency(stage, one["speed"]), one["torque"]
        scale = 1 / np.sqrt(np.diag(oracle.K))
        ground = oracle.K.copy()
        if one["sun_torsion"] == 0 and one["output_torsion"] == 0:
            ground[2, 2] += one["sun_planet_mesh"] * one["sun_base"] ** 2  # the sun is held at zero
        least = np.linalg.eigvalsh(scale[:, None] * ground * scale)[0]
        due = Status.CONVERGED if least > 1e-10 else -1
        if least < 1e-15 and whole_model:
            due = Status.SINGULAR
        if least < 1e-10 or one["loss"] < 0.01:
            return int(due), 0.0
        oracle.K, free = ground, oracle.K
        mean = oracle.mean(torque)
        oracle.K = free
        if method == "first_order":
            oracle.mean = lambda _: mean
            amplitude = oracle.first_order(stage, w, HARMONICS, torque)[:, rows]
        else:
            if not np.array_equal(ground, free):
                return int(due), 0.0
            motion = oracle.harmonic_balance(stage, w, HARMONICS, torque)
            amplitude, mean = 2 * motion[HARMONICS + 1 :, rows], motion[HARMONICS].real
        amplitude, mean = amplitude * np.array(ARMS), mean[rows] * np.array(ARMS)
        size = np.abs(mean).max() + np.abs(amplitude).max() or 1.0
        found, rest = (np.asarray(value)[lane] for value in out["values"])
        off = np.abs(np.abs(found) - np.abs(amplitude) / size)  # of a backward turn the phases are mirrored
        return int(due), float(max(off.max(), np.abs(rest - mean / size).max()))

    whole_model = discs == 1 or (method == "harmonic_balance" and not (cranks >= 3 and discs >= 3))
    return Model(
        f"dynamics {method}",
        f"dynamics {method} {stage} {cranks} cranks {discs} discs",
        draw_reducer,
        run,
        judge,
        relative_step,
        ordinary=ordinary,
    )
