"""Springs and masses of the lumped model: one table of deflection vectors gives K, for any number of parts.

Every part moves in the plane with (x, y, rotation), rotation counter-clockwise: sun, planets, cranks, discs,
output wheel. Sun and output use the fixed frame; planet and crank i the frame at psi_i = 2 pi (i-1)/M with x
radially outwards; disc j the frame at psi_cj = disc_phase + 2 pi (j-1)/N with x along its eccentricity. The
deflection of a spring is v.q with v linear in thirteen numbers of the design (`geometry_numbers`), so that
v, K = sum k v v^T and their derivatives are products with constant arrays.

Source: Yang, Chen, Wang, Chin. J. Mech. Eng. 31:49 (2018), doi 10.1186/s10033-018-0249-y, Eq. 1 and Appendix.
"""

import functools
import operator
from collections.abc import Sequence
from dataclasses import fields
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.fields import axis_sizes
from rvjax.catalogue import RV_320E
from rvjax.designs import Damping, Inertia, MeshVariation, RVReducer, Stiffness, check_teeth, expect, ratio_of
from rvjax.records import (
    Array,
    PyTree,
    Record,
    Scalar,
    check_shapes,
    concrete,
    count,
    field,
    promote,
    record,
    signs_hold,
    text,
)
from rvjax.status import Gate, Status, admit, window


@record
class Lumped(Record):
    """Parameters of the lumped model; `eccentricity` and `force_arm` may vary independently."""

    cranks: int = count("planets and crankshafts, M", minimum=2)
    discs: int = count("discs, N")
    sun_teeth: int = count("teeth of the sun")
    planet_teeth: int = count("teeth of a planet")
    disc_teeth: int = count("teeth of a disc; the ring has one pin more")
    sun_base_radius: Scalar = field("m", "base radius of the sun, rs", sign="positive")
    planet_base_radius: Scalar = field("m", "base radius of a planet, rp", sign="positive")
    eccentricity: Scalar = field("m", "eccentricity of the cranks, e", sign="positive")
    force_arm: Scalar = field("m", "rolling radius of a disc, rc = e disc_teeth unless set", sign="positive")
    circle_radius: Scalar = field("m", "radius of the circle of crank axes, rH", sign="positive")
    pressure_angle: Scalar = field("rad", "of the sun-planet mesh, alpha")
    force_angle: Scalar = field("rad", "of the disc-pin mesh, beta")
    disc_phase: Scalar = field("rad", "eccentric direction of disc 1")
    inertia: Inertia = field("-", "masses and moments of inertia", kind="record")
    stiffness: Stiffness = field("-", "stiffnesses", kind="record")
    mesh_variation: MeshVariation = field("-", "periodic mesh stiffness", kind="record")
    damping: Damping = field("-", "damping", kind="record")

    @property
    def ratio(self) -> float:
        """Turns of the sun for one of the output."""
        return ratio_of(self.sun_teeth, self.planet_teeth, self.disc_teeth, self.disc_teeth + 1)

    @property
    def alike(self) -> bool:
        """True if all members of a kind share one number, so that equal spacing makes the model symmetric."""
        return all(jnp.ndim(leaf) == 0 for leaf in jax.tree.leaves((self.inertia, self.stiffness)))


@record
class System(Record):
    """Mass and mean stiffness of the whole reducer in physical coordinates."""

    mass: Array = field("kg, kg m2", "diagonal of the mass matrix", shape=("n",))
    stiffness: Array = field("N/m, N, N m", "mean stiffness matrix", shape=("n", "n"))
    labels: tuple[str, ...] = text("names of the coordinates")


def lump(design: RVReducer | Lumped) -> Lumped:
    """Return the lumped parameters of a reducer; a Lumped passes through.

    Args:
        design: a reducer with inertia and stiffness; without mesh_variation its meshes are constant, without
            damping it is undamped.

    Raises:
        ValueError: a part is missing, a ring without exactly one pin more than the disc has teeth, a
            concrete zero stiffness that leaves the torque no path, or an array that has not one number for each
            member.
    """
    if isinstance(design, Lumped):
        return design
    expect(design, "dynamics", RVReducer, Lumped)
    if design.inertia is None or design.stiffness is None:
        missing = "inertia" if design.inertia is None else "stiffness"
        raise ValueError(f"RVReducer.{missing} = None: the dynamic model needs it")
    stage = design.cycloid
    check_teeth(stage, model=" (dynamics)")
    for name in ("planet_crank_torsion", "disc_pin_mesh", "turning_arm_bearing"):
        value = getattr(design.stiffness, name)
        if concrete(value) and np.any(np.asarray(value) == 0):
            raise ValueError(f"Stiffness.{name} = 0: no path for the torque; must be positive")
    check_shapes([design.inertia, design.stiffness], design.counts)
    return Lumped(
        cranks=design.cranks.count,
        discs=stage.disc_count,
        sun_teeth=design.involute.sun_teeth,
        planet_teeth=design.involute.planet_teeth,
        disc_teeth=stage.disc_teeth,
        sun_base_radius=design.involute.sun_base_radius,
        planet_base_radius=design.involute.planet_base_radius,
        eccentricity=stage.eccentricity,
        force_arm=stage.eccentricity * stage.disc_teeth,
        circle_radius=design.cranks.circle_radius,
        pressure_angle=design.involute.pressure_angle,
        force_angle=stage.force_angle,
        disc_phase=stage.disc_phase,
        inertia=design.inertia,
        stiffness=design.stiffness,
        mesh_variation=design.mesh_variation or MeshVariation(0.0, 0.5, 0.0, 0.0, 0.5, 0.0),
        damping=design.damping or Damping(),
    )


def loaded(lumped: Lumped, load_inertia: Scalar) -> Lumped:
    """Add the inertia that the output drives.

    Args:
        lumped: parameters of the reducer.
        load_inertia: () kg m2.
    """
    inertia = lumped.inertia
    return lumped.replace(inertia=inertia.replace(output_inertia=inertia.output_inertia + load_inertia))


def admitted(lumped: Lumped, *conditions: object) -> tuple[Lumped, tuple[PyTree, ...], Gate]:
    """Promote to one dtype, replace a case outside the model's domain by a harmless one, and return its gate.

    Design and conditions are checked separately, so that a sweep of conditions leaves the design, and with it the
    eigenproblem, one.
    """
    lumped, conditions = promote(lumped, conditions)
    numbers = _flat(jax.tree.leaves(lumped))
    _, largest = window(numbers, 0.4)  # products of two numbers, and their quotients, are formed
    least, _ = window(numbers, 0.5)  # squares are formed, and quotients in derivatives

    def fits(x: jax.Array) -> jax.Array:
        return (jnp.abs(x) < largest) & ((x == 0) | (jnp.abs(x) > least))

    radii = (lumped.sun_base_radius, lumped.planet_base_radius, lumped.eccentricity, lumped.circle_radius)
    smallest = jnp.min(_flat([*radii, *jax.tree.leaves(lumped.inertia)]))
    finite = jnp.all(fits(numbers)) & (~(smallest > 0) | (smallest > 1 / largest))
    possible = (smallest > 0) & signs_hold(lumped.stiffness)
    possible &= jnp.abs(jnp.cos(lumped.force_angle)) >= 1e-9  # else the pins carry no torque
    refusals = ((~finite, Status.NONFINITE), (~possible, Status.INVALID_GEOMETRY))
    sound = jax.tree.unflatten(jax.tree.structure(lumped), jax.tree.leaves(lump(RV_320E)))  # in its shape
    lumped, gate = admit(lumped, sound, *refusals)
    judged = [jnp.any(~fits(c)) for c in jax.tree.leaves(conditions)]
    for_any = functools.reduce(operator.or_, judged, jnp.asarray(False))
    conditions = jax.tree.map(lambda c: jnp.where(fits(c), c, 1), conditions)
    return lumped, conditions, Gate((*gate.refused, (for_any, Status.NONFINITE)))


def _flat(leaves: list[PyTree]) -> jax.Array:
    return jnp.concatenate([jnp.ravel(leaf) for leaf in leaves])


def assemble(design: RVReducer | Lumped) -> System:
    """Mass and mean stiffness matrix of the whole reducer.

    Args:
        design: a reducer with inertia and stiffness, or its lumped parameters.

    Returns:
        System of n = 6 M + 3 N + 6 coordinates (M cranks, N discs), labelled `sun.x` ... `output.rotation`.

    Raises:
        ValueError: as `lump`.
    """
    return _assemble(lump(design))


@jax.jit
def _assemble(lumped: Lumped) -> System:
    lumped = promote(lumped)
    table = spring_table(lumped.cranks, lumped.discs)
    rows = deflections(lumped, table.rows)
    stiffness = rows.T @ (spring_stiffness(lumped)[:, None] * rows)
    symmetric = (stiffness + stiffness.T) / 2  # the product is so to rounding only
    return System(mass=mass_vector(lumped), stiffness=symmetric, labels=table.labels)


def mass_vector(lumped: Lumped) -> jax.Array:
    """Diagonal of the mass matrix (n,)."""
    mass, turning = (_by_member(lumped, lumped.inertia, [f"{p}_{name}" for p in PARTS]) for name in ("mass", "inertia"))
    return jnp.stack([mass, mass, turning], axis=1).ravel()


def spring_stiffness(lumped: Lumped) -> jax.Array:
    """Stiffness of every spring of the table (springs,)."""
    return _by_member(lumped, lumped.stiffness, SPRINGS)[spring_table(lumped.cranks, lumped.discs).member]


def _by_member(lumped: Lumped, part: Inertia | Stiffness, names: Sequence[str]) -> jax.Array:
    """Fields of a record one after the other, with one number for each member."""
    counts = dict(cranks=lumped.cranks, discs=lumped.discs)
    declared = {f.name: f.metadata["shape"] for f in fields(part)}
    return _flat([jnp.broadcast_to(getattr(part, name), axis_sizes(declared[name], counts)) for name in names])


def geometry_numbers(lumped: Lumped) -> jax.Array:
    """Return the thirteen numbers in which all deflection vectors are linear."""
    ca, sa = jnp.cos(lumped.pressure_angle), jnp.sin(lumped.pressure_angle)
    cp, sp = jnp.cos(lumped.disc_phase), jnp.sin(lumped.disc_phase)
    cb, sb = jnp.cos(lumped.force_angle), jnp.sin(lumped.force_angle)
    e = lumped.eccentricity
    rs, rp, rh = lumped.sun_base_radius, lumped.planet_base_radius, lumped.circle_radius
    return jnp.stack([jnp.ones_like(ca), ca, sa, rs, rp, rh, cp, sp, e * cp, e * sp, cb, sb, lumped.force_arm * cb])


def deflections(lumped: Lumped, rows: np.ndarray) -> jax.Array:
    """Deflection vectors from the constant array `rows` (13, springs, coordinates), real or complex."""
    numbers = geometry_numbers(lumped)
    if np.iscomplexobj(rows):
        numbers = jax.lax.complex(numbers, jnp.zeros_like(numbers))
    return jnp.tensordot(numbers, jnp.asarray(rows, numbers.dtype), axes=1)


PARTS = ("sun", "planet", "crank", "disc", "output")
SPRINGS = (
    "sun_support",
    "sun_torsion",
    "planet_crank_bending",
    "planet_crank_torsion",
    "support_bearing",
    "turning_arm_bearing",
    "sun_planet_mesh",
    "disc_pin_mesh",
    "output_support",
    "output_torsion",
)
_ONE, _CA, _SA, _RS, _RP, _RH, _CP, _SP, _ECP, _ESP, _CB, _SB, _RCB = range(13)


class SpringTable(NamedTuple):
    """Constants of a layout of M cranks and N discs; n coordinates."""

    rows: np.ndarray  # (13, springs, n): deflection vectors in terms of `geometry_numbers`
    kind: np.ndarray  # (springs,): index into SPRINGS
    member: np.ndarray  # (springs,): index into the stiffnesses of all kinds and members in turn
    part: np.ndarray  # (n,): index into PARTS
    labels: tuple[str, ...]

    def of(self, name: str) -> np.ndarray:
        """Positions of the springs of one kind."""
        return np.flatnonzero(self.kind == SPRINGS.index(name))


def circle(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cosine and sine of `count` equal steps round a circle, with clean zeros."""
    return clean_direction(2 * np.pi * np.arange(count) / count)


def clean_direction(angle: float | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cosine and sine, with exact zeros at multiples of a right angle."""
    direction = np.stack([np.cos(angle), np.sin(angle)])
    direction[np.abs(direction) < 1e-15] = 0
    return direction[0], direction[1]


def roots_of_one(count: int, steps: np.ndarray) -> np.ndarray:
    """e^{2 pi i steps / count} from integer steps: no rounding however many, with clean zeros."""
    cosine, sine = circle(count)
    return cosine[steps % count] + 1j * sine[steps % count]


def waves(members: int, steps: int) -> np.ndarray:
    """e^{2 pi i steps j / members} of members j = 0 .."""
    return roots_of_one(members, steps * np.arange(members))


def first_index(cranks: int, discs: int) -> dict[str, int]:
    """Index of the x coordinate of the first member of each part."""
    return dict(zip(PARTS, np.cumsum([0, 3, 3 * cranks, 3 * cranks, 3 * discs]).tolist()))


@functools.lru_cache
def spring_table(cranks: int, discs: int) -> SpringTable:
    """Springs of a layout: support, shafts, bearings and meshes as in Section 2 of the source."""
    start = first_index(cranks, discs)
    sun, output = start["sun"], start["output"]
    size = output + 3
    rows: list[tuple[str, int, list[tuple[int, int, Any]]]] = []

    def spring(kind: str, member: int, *terms: tuple[int, int, object]) -> None:
        rows.append((kind, member, list(terms)))  # terms: (coordinate, geometry number, factor)

    for x, name in ((sun, "sun"), (output, "output")):
        spring(f"{name}_support", 0, (x, _ONE, 1))
        spring(f"{name}_support", 0, (x + 1, _ONE, 1))
        spring(f"{name}_torsion", 0, (x + 2, _ONE, 1))
    cosine, sine = circle(cranks)
    for i in range(cranks):
        c, s = cosine[i], sine[i]
        p, h = start["planet"] + 3 * i, start["crank"] + 3 * i
        spring(  # cos(a) xs + sin(a) ys + rs ths - sin(al) xp - cos(al) yp + rp thp, a = psi_i + pi/2 - al
            *("sun_planet_mesh", i),
            *((sun, _SA, c), (sun, _CA, -s), (sun + 1, _CA, c), (sun + 1, _SA, s), (sun + 2, _RS, 1)),
            *((p, _SA, -1), (p + 1, _CA, -1), (p + 2, _RP, 1)),
        )
        for axis, kind in enumerate(("bending", "bending", "torsion")):
            spring(f"planet_crank_{kind}", i, (p + axis, _ONE, 1), (h + axis, _ONE, -1))
        spring("support_bearing", i, (h, _ONE, 1), (output, _ONE, -c), (output + 1, _ONE, -s))
        spring("support_bearing", i, (h + 1, _ONE, 1), (output, _ONE, s), (output + 1, _ONE, -c), (output + 2, _RH, -1))
        for j in range(discs):
            x = start["disc"] + 3 * j
            turn = 2 * np.pi * (j * cranks - i * discs) / (cranks * discs)  # phi_ij without the phase of disc 1
            c, s = clean_direction(turn)
            spring(  # xH - e sin(phi) thH - cos(phi) xc + sin(phi) yc
                *("turning_arm_bearing", j * cranks + i),
                *((h, _ONE, 1), (h + 2, _ESP, -c), (h + 2, _ECP, -s)),
                *((x, _CP, -c), (x, _SP, s), (x + 1, _SP, c), (x + 1, _CP, s)),
            )
            spring(  # yH + e cos(phi) thH - sin(phi) xc - cos(phi) yc - rH thc
                *("turning_arm_bearing", j * cranks + i),
                *((h + 1, _ONE, 1), (h + 2, _ECP, c), (h + 2, _ESP, -s)),
                *((x, _SP, -c), (x, _CP, -s), (x + 1, _CP, -c), (x + 1, _SP, s), (x + 2, _RH, -1)),
            )
    for j in range(discs):
        x = start["disc"] + 3 * j
        spring("disc_pin_mesh", j, (x, _SB, 1), (x + 1, _CB, 1), (x + 2, _RCB, 1))

    table = np.zeros((13, len(rows), size))
    for k, (_, _, terms) in enumerate(rows):
        for coordinate, number, factor in terms:
            table[number, k, coordinate] += factor
    members = dict(zip(PARTS, (1, cranks, cranks, discs, 1)))
    labels = tuple(
        f"{name}{i + 1 if name in ('planet', 'crank', 'disc') else ''}.{axis}"
        for name in PARTS
        for i in range(members[name])
        for axis in ("x", "y", "rotation")
    )
    part = np.repeat(np.arange(5), [3 * members[name] for name in PARTS])
    kinds = np.array([SPRINGS.index(name) for name, _, _ in rows])
    own = np.array([member for _, member, _ in rows])
    first = np.cumsum([0] + [own[kinds == k].max() + 1 for k in range(len(SPRINGS) - 1)])
    return SpringTable(table, kinds, first[kinds] + own, part, labels)
