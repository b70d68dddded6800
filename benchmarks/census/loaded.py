"""The loaded reducer for the census: draws to overload and interference, checked by minima certified in 80-bit numbers.

The reference minimises the energy and keeps a minimum only where its gradient in 80-bit numbers has vanished: the
energy is convex, so there is no other. What a model returns may be off by what its rule to stop leaves.
"""

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np

from benchmarks.census.cases import Case, Model, decades, deviations, moderate, nonfinite
from rvjax import RVErrors, RVReducer, catalogue, loaded
from rvjax.designs import Contact
from rvjax.status import Status
from tests.oracles import loaded as oracle
from tests.oracles.loaded_machine import ERRORS, STAGES

LANES = 1024  # that the reference holds at once
RATED = 7e-5  # of E L rr a pin carries at rated torque: 500 N in an RV-40E
RESIDUAL = 1e-10  # bound of the page, where rounding allows it
RESULTS = ("pins", "disc_bearing", "support_bearing", "gear")


def machine(
    contact: str, cranks: int, discs: int, teeth: int, carrier: str = "fixed", sun: str = "fixed", given: bool = False
) -> Model:
    """One layout; `given`: stiffness of a pin (linear), or of its support (hertz), is a number of its own."""
    layout = dict(contact=contact, cranks=cranks, discs=discs, teeth=teeth, carrier=carrier, sun=sun, given=given)
    afloat = "".join(f" {n} floating" for n, way in (("carrier", carrier), ("sun", sun)) if way == "floating")
    return Model(
        f"loaded {contact}",
        f"loaded {contact} {cranks} cranks {discs} discs {teeth} teeth{afloat}{' given stiffness' if given else ''}",
        functools.partial(draw, **layout),
        functools.partial(run, **layout),
        functools.partial(judge, **layout),
        step,
        ordinary=functools.partial(ordinary, teeth=teeth),
        judged=0.1,
        faint=1e-6,  # a contact that has just closed: its slope jumps, or begins at zero
        sound=functools.partial(sound, teeth=teeth),
    )


def error_shapes(cranks: int, discs: int, teeth: int) -> dict[str, tuple[int, ...]]:
    sizes = {"d": discs, "c": cranks, "p": teeth + 1, "t": teeth, "2": 2, "5": 5}
    return {name: tuple(sizes[axis] for axis in axes) for name, axes in ERRORS.items()}


def draw(
    rng: Any, size: int, contact: str, cranks: int, discs: int, teeth: int, carrier: str, sun: str, given: bool
) -> Case:
    """Reducers about to be undercut and beyond, errors from nothing to a tenth of a pin, torques over ten decades."""
    pins = teeth + 1
    ring = decades(rng, size, -2.5, 0)
    near = 1 - decades(rng, size, -9, -1.5) * rng.choice([-1, 1], size)
    k1 = np.where(rng.uniform(size=size) < 0.05, near, rng.uniform(0.1, 0.95, size))
    square = np.clip(3 * teeth * (1 - k1**2) / (pins + 1), (1 - k1) ** 2, (1 + k1) ** 2)
    bend = (1 + pins * k1**2 - (1 + pins) * (1 + k1**2 - square) / 2) / square**1.5 / ring
    pin = rng.uniform(0.1, 1.02, size) * np.where(rng.uniform(size=size) < 0.9, 0.7, 1) / np.maximum(bend, 1 / ring)
    modulus, width = decades(rng, size, 9, 12), pin * decades(rng, size, -0.3, 1)
    circle, angle = ring * rng.uniform(0.3, 0.9, size), rng.uniform(0.1, 0.6, size)
    z1, z2 = catalogue.RV_40E.involute.sun_teeth, catalogue.RV_40E.involute.planet_teeth
    base = circle * np.cos(angle) / (z1 + z2)
    stiff = modulus * width

    def of_parts(shape: tuple[int, ...]) -> np.ndarray:
        lanes = (size,) + (1,) * len(shape)
        alike = decades(rng, lanes, -2, 0.5) * rng.uniform(0.8, 1.2, (size, *shape))
        wild = decades(rng, (size, *shape), -3, 2)
        return stiff.reshape(lanes) * np.where(rng.uniform(size=lanes) < 0.95, alike, wild)

    case = {
        "sun_base_radius": base * z1, "planet_base_radius": base * z2, "pressure_angle": angle,
        "eccentricity_of_design": k1 * ring / pins, "pin_circle_radius_of_design": ring,
        "pin_radius_of_design": pin, "circle_radius": circle,
        "turning_arm_bearing": of_parts((discs, cranks)), "support_bearing": of_parts((cranks,)),
        "sun_planet_mesh": of_parts((cranks,)), "planet_crank_bending": of_parts((cranks,)),
        "planet_crank_torsion": of_parts((cranks,)) * (base * z2)[:, None] ** 2,
        "young_modulus": modulus, "poisson_ratio": rng.uniform(-0.5, 0.49, size), "face_width": width,
    }  # fmt: skip
    if carrier == "floating":
        case["output_support"] = of_parts(())
    if sun == "floating":
        case |= {"sun_support": of_parts(()), "sun_torsion": of_parts(()) * (base * z1) ** 2}
    if contact == "linear":
        case |= {"pin_stiffness": 0.1 * of_parts(())} if given else {"disc_pin_mesh": of_parts((discs,))}
    elif contact == "hertz" and given:
        case["pin_support"] = of_parts(())
    usual = rng.uniform(size=size) < 0.5  # errors of micrometres and some of the rated torque
    for name, shape in error_shapes(cranks, discs, teeth).items():
        part = {"crank_phase": 0.1 * np.ones(size), "eccentricity": 0.1 * k1 * ring / pins}.get(name, 0.1 * pin)
        level = np.where(usual, 0.02 * np.minimum(1, k1 * ring / pins / pin), decades(rng, size, -4, 0))
        case[name] = deviations(rng, (size, *shape), part * level)
    case["torque"] = rated(case, teeth, discs) * np.where(usual, decades(rng, size, -2, 0.5), decades(rng, size, -6, 2))
    case["torque"] = case["torque"] * rng.choice([-1, 1], size) * (rng.uniform(size=size) > 0.05)
    return case | {"angle": np.where(rng.uniform(size=size) < 0.03, 0, rng.uniform(-700, 700, size))}


def rated(case: Case, teeth: int, discs: int) -> Any:
    """Torque at which a pin carries what it does in an RV-40E."""
    load = RATED * case["young_modulus"] * case["face_width"] * case["pin_radius_of_design"]
    return discs * teeth * case["eccentricity_of_design"] * (teeth + 1) / 4 * load


def parts(case: Case) -> dict[str, dict[str, Any]]:
    """Numbers by the record that holds them."""
    names = {name: name for stage in STAGES.values() for name in stage}
    names |= {name: f"{name}_of_design" for name in ("eccentricity", "pin_circle_radius", "pin_radius")}
    stages = {
        stage: {name: case[names[name]] for name in fields if names[name] in case and name not in SHARED}
        for stage, fields in STAGES.items()
    }
    return stages | {"errors": {name: case[name] for name in ERRORS}}


# Names that designs and errors share and the designs of the census leave at their default.
SHARED = ("equidistant_modification", "shift_modification", "force_angle")


def build(case: Case, cranks: int, discs: int, teeth: int) -> tuple[RVReducer, RVErrors]:
    part, base = parts(case), catalogue.RV_40E
    spare = dict.fromkeys(("sun_support", "sun_torsion", "disc_pin_mesh"), jnp.ones_like(case["torque"]))
    design = base.replace(
        involute=base.involute.replace(**part["involute"]),
        cycloid=base.cycloid.replace(disc_teeth=teeth, pin_count=teeth + 1, disc_count=discs, **part["cycloid"]),
        cranks=base.cranks.replace(count=cranks, **part["cranks"]),
        stiffness=catalogue.RV_320E.stiffness.replace(**spare | part["stiffness"]),
        contact=Contact(**part["contact"]),
    )
    return design, RVErrors(**part["errors"])


def run(
    case: Case, contact: str, cranks: int, discs: int, teeth: int, carrier: str, sun: str, given: bool
) -> dict[str, Any]:
    design, errors = build(case, cranks, discs, teeth)
    got = loaded.equilibrium(
        design, errors, input_angle=case["angle"], output_torque=case["torque"], contact=contact, carrier=carrier,
        sun=sun,
    )  # fmt: skip
    # The error as the force of a bearing that it would deflect, and the forces; all over the largest of them.
    stiff, radius = (jnp.where(jnp.isfinite(case[n]), case[n], 1) for n in ("turning_arm_bearing", "circle_radius"))
    force = jnp.mean(stiff) * radius
    largest = jnp.max(jnp.stack([jnp.max(jnp.abs(getattr(got, name))) for name in RESULTS]))
    largest = jnp.maximum(largest, jnp.abs(case["torque"]) / case["circle_radius"])
    known = jnp.isfinite(got.error)  # a NaN times the force would be the slope of the force
    force = jnp.where(known, force, 1)
    return dict(
        values=(
            jnp.where(known, jnp.where(known, got.error, 0) * force, jnp.nan),
            *(getattr(got, name) for name in RESULTS),
        ),
        status=got.info.status,
        residual=got.info.residual,
        residual_scale=jnp.maximum(1, jnp.where(largest > 0, rounding(case) / largest / RESIDUAL, jnp.inf)),
        scale=jnp.where(largest > 0, largest, 1),
        windup=(got.error, got.pressure, got.stiffness, got.disc_torque, got.input_torque),
    )


def rounding(case: Case) -> Any:
    """Force that the rounding of the gaps alone makes in the stiffest spring: no equilibrium is known better."""
    stiffest = [jnp.max(jnp.abs(case[n])) for n in ("turning_arm_bearing", "support_bearing", "sun_planet_mesh")]
    gaps = {name: jnp.max(jnp.abs(case[name])) for name in ERRORS}
    gaps["crank_phase"] = gaps["crank_phase"] * jnp.abs(case["eccentricity_of_design"])
    return 2 * np.finfo(float).eps * jnp.max(jnp.stack(stiffest)) * sum(gaps.values())


def judge(
    case: Case, out: Any, contact: str, cranks: int, discs: int, teeth: int, carrier: str, sun: str, given: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Status and distance from the certified minimum, over the largest force and what the rule to stop leaves."""
    size, status = len(case["torque"]), np.asarray(out["status"])
    due, off = np.full(size, -1), np.zeros(size)
    within = sound(case, teeth)
    for begin in range(0, size, LANES):
        lanes = np.arange(begin, min(begin + LANES, size))
        part = {name: value[lanes] for name, value in case.items()}
        own = parts(part)
        spare = dict.fromkeys(("sun_support", "sun_torsion", "disc_pin_mesh"), 1.0)
        design = {
            "involute": own["involute"] | {"sun_teeth": catalogue.RV_40E.involute.sun_teeth,
                                           "planet_teeth": catalogue.RV_40E.involute.planet_teeth},
            "cycloid": own["cycloid"] | {"disc_teeth": teeth, "pin_count": teeth + 1, "disc_count": discs},
            "cranks": own["cranks"] | {"count": cranks},
            "stiffness": spare | own["stiffness"],
            "contact": own["contact"],
        }  # fmt: skip
        options = dict(contact=contact, carrier=carrier, sun=sun)
        read = dict(input_angle=part["angle"], output_torque=part["torque"], **options)
        with np.errstate(all="ignore"):
            found = oracle.equilibria(design, own["errors"], len(lanes), steps=100, **read)
            due[lanes], certain = statuses(part, found, design, own["errors"], read)
        force = part["turning_arm_bearing"].reshape(len(lanes), -1).mean(1) * part["circle_radius"]
        scale = np.asarray(out["scale"])[lanes]
        # 1e-9 of the scale is allowed, and ten times what the rule to stop leaves.
        error_over = scale + 1e10 * found["error_allowed"] * force
        force_over = scale + 1e10 * found["force_allowed"]
        apart = np.abs(np.asarray(out["values"][0])[lanes] - found["error"] * force) / error_over
        for value, name in zip(out["values"][1:], RESULTS):
            gap = np.abs(np.asarray(value)[lanes] - found[name]).reshape(len(lanes), -1).max(1)
            apart = np.maximum(apart, gap / force_over)
        off[lanes] = np.where(certain & (status[lanes] == due[lanes]), apart, 0)
    # A torque that the centring springs carry, or whose forces are below the rounding of the gaps, is no load.
    faint, pins = np.sqrt(np.finfo(float).eps), np.abs(np.asarray(out["values"][1])).reshape(size, -1).max(1)
    lost = (np.asarray(out["residual"]) > faint) | (pins <= faint * np.abs(case["torque"]) / case["circle_radius"])
    due = np.where(lost & (status == Status.UNLOADED) & (due == Status.CONVERGED), -1, due)
    # Far out the steps may run out: a reason, and no other due.
    due = np.where(~within & (status == Status.MAX_STEPS), -1, due)
    return due, off


def statuses(part: Case, found: dict[str, Any], design: Any, errors: Any, read: dict[str, Any]) -> tuple[Any, Any]:
    """Expected status of every batch element, -1 where it is not known, and where the minimum is certain."""
    numbers = oracle.read(design, errors, lanes=len(part["torque"]), **read)
    possible, thick = oracle.positive(numbers), oracle.undercut(numbers)
    certain = found["usable"] & (found["residual"] < 1e-14) & tame(part)
    due = np.where(part["torque"] == 0, np.where(found["loaded"] == 1, Status.CONVERGED, Status.UNLOADED), 0)
    largest = np.abs(found["pins"]).reshape(len(due), -1).max(1)
    edge = 1e-8 * part["turning_arm_bearing"].reshape(len(due), -1).mean(1) * part["pin_radius_of_design"]
    due = np.where((part["torque"] == 0) & (np.abs(largest - edge) < 0.1 * edge), -1, due)
    # Where the start is overloaded, or nearly, CONTACT_OVERLOAD is as valid as the solution.
    due = np.where(found["bend"] <= 1, Status.CONTACT_OVERLOAD, due)
    due = np.where((found["bend"] > 1) & (found["bend"] < 3), -1, due)
    due = np.where(certain, due, -1)
    due = np.where(possible & (thick >= 1), Status.UNDERCUT, due)
    due = np.where(np.abs(thick - 1) < 1e-9, -1, due)
    due = np.where(possible, due, Status.INVALID_GEOMETRY)
    due = np.where(tame(part) | (due == Status.INVALID_GEOMETRY), due, -1)
    # Finite numbers too large or too small for the arithmetic may be named NONFINITE before the geometry is checked.
    due = np.where((~moderate(part) | vanishing(part)) & (due == Status.INVALID_GEOMETRY), -1, due)
    return np.where(nonfinite(part), Status.NONFINITE, due), certain


def tame(case: Case) -> np.ndarray:
    """Numbers far from overflow and underflow, and stiffnesses that 80-bit numbers can distinguish."""
    good = moderate(case, 1e15) & ~vanishing(case)
    stiff = [case[n].reshape(len(good), -1) for n in ("turning_arm_bearing", "support_bearing", "sun_planet_mesh")]
    together = np.abs(np.concatenate(stiff, 1))
    good &= together.max(1) < 1e8 * together.min(1)
    return good & (np.abs(case["angle"]) < 1e4) & (np.abs(case["crank_phase"]).max(1) < 1e4)


def vanishing(case: Case) -> np.ndarray:
    """A number of the design so small that products of it vanish."""
    design = set(case) - set(ERRORS) - {"torque", "angle"}
    sizes = [np.abs(case[name].reshape(len(case["torque"]), -1)) for name in sorted(design)]
    return np.any([((size < 1e-100) & (size > 0)).any(1) for size in sizes], axis=0)


def sound(case: Case, teeth: int) -> np.ndarray:
    """Admissible reducers: errors up to a fiftieth of a pin, stiffnesses within 1e4 of each other."""
    good = tame(case) & ~nonfinite(case)
    for name in ERRORS:
        size = 0.02 if name == "crank_phase" else 0.02 * np.minimum(
            case["pin_radius_of_design"], case["eccentricity_of_design"])  # fmt: skip
        good &= np.abs(case[name]).reshape(len(good), -1).max(1) <= size
    stiff = [case[n].reshape(len(good), -1) for n in ("turning_arm_bearing", "support_bearing", "sun_planet_mesh")]
    stiff += [case["planet_crank_bending"], case["planet_crank_torsion"] / case["planet_base_radius"][:, None] ** 2]
    stiff = np.concatenate([*stiff, (case["young_modulus"] * case["face_width"])[:, None]], 1)
    return good & (stiff.max(1) < 1e4 * stiff.min(1)) & (stiff.min(1) > 0)


def ordinary(case: Case, teeth: int) -> np.ndarray:
    """Near rated torque, errors below a five-hundredth of a pin, K1 below 0.9: where float32 has a bound."""
    discs = case["turning_arm_bearing"].shape[1]
    part = np.abs(case["torque"]) / np.where(rated(case, teeth, discs) > 0, rated(case, teeth, discs), np.inf)
    good = sound(case, teeth) & (part > 0.1) & (part < 3)
    for name in ERRORS:
        size = 0.002 if name == "crank_phase" else 0.002 * np.minimum(
            case["pin_radius_of_design"], case["eccentricity_of_design"])  # fmt: skip
        good &= np.abs(case[name]).reshape(len(good), -1).max(1) <= size
    k1 = case["eccentricity_of_design"] * (teeth + 1) / case["pin_circle_radius_of_design"]
    return good & (k1 < 0.9) & (k1 > 0.1) & (np.abs(case["angle"]) < 150)


def step(name: str, value: Any) -> Any:
    """A millionth of a number: a contact that opens or closes on the way bends the differences."""
    return 1e-6 * np.abs(value)
