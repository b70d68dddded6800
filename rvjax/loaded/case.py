"""One case: the numbers of design and errors that it reads, and the results of its equilibrium.

An equilibrium, from the call to the result:

     1  layout = check_input(design, errors, contact, ..)      on the host: counts and methods, static
     2  jit(_equilibrium), layout static                       `quick`; a part of the user's program inside `jax.jit`
     3      read = admit(layout, design, errors, torque, ..)   harmless numbers where given ones are impossible
     4      case = prepare(layout, read, angle).loaded(torque) geometry, gaps, springs: a `System`
     5      found = balance(layout, case.system, start)        without derivatives, in a `BatchedKernel`: a primitive
     6          for each block of waiting cases:               that is traced when the program is lowered, and whose
     7              while a case is open:                      batch axis joins all levels of `jax.vmap`
     8                  contacts, gradient and Hessian at q, Newton's step from there, of a drive `shortened`
     9                  rows = decided(rows, merit), q = onward(..)        full step, or a point of a line
    10      q = at_output(layout, case, found, status)         dq = -H^-1 d(grad E): its `custom_jvp`, two kernels more
    11      pins, joints, bearings = forces(layout, case.system, q)        a `BatchedKernel`, too
    12      return Loaded(..), NaN where the status is none of success

The state of line 7 has the cases of a block last (l). A row of `q` (n, l) is an unknown: three for each disc, then
those of the border, see `system`. A row of `rows` is a field of `line_search.Element`: numbers (energy, bracket,
residual) in one array, counts and marks in the other.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp

from rvjax import status
from rvjax._jax.elementary import LARGEST_ANGLE
from rvjax.errors import Errors, read_by
from rvjax.geometry import least_convex_radius
from rvjax.loaded.balance import balance, forces, with_implicit_derivative
from rvjax.loaded.newton import Minimum
from rvjax.loaded.system import Layout, System
from rvjax.records import Record, Scalar, promote
from rvjax.status import Gate, SolveInfo, Status, succeeded

Part = TypeVar("Part", bound=Record)
SUPPORTS = ("fixed", "floating")


class Read(NamedTuple):
    """Numbers that the model reads; harmless ones where they were not finite or not possible."""

    design: Any
    errors: Any
    eccentricity: Any  # nominal and error
    torque: Any
    angle: Any
    gate: Gate


def admitted(
    design: Record,
    errors: Errors,
    torque: Scalar,
    angle: Scalar,
    positive: Callable[[object], jax.Array],
    negative: Callable[[object], jax.Array],
) -> Read:
    """Check the numbers that are read.

    Design, eccentricity, errors, torque and angle are checked and replaced separately, so that all units of a batch
    over errors keep one geometry.

    Args:
        design: the reducer, with a cycloid stage and constants in place of what the model does not read.
        errors: of its parts.
        torque: () N m.
        angle: () rad.
        positive: (k,) numbers of the design that must be positive, without the eccentricity.
        negative: () true where a spring that may be zero is negative.
    """
    read = read_by(errors, "loaded")
    unread = {f.name: 0.0 for f in dataclasses.fields(errors) if f.name not in read}
    used, parts, torque, angle = promote(design, errors.replace(**unread), torque, angle)
    e, added = used.cycloid.eccentricity, parts.eccentricity
    parts = parts.replace(eccentricity=jnp.zeros_like(added))

    sizes = positive(used)
    spare = jax.tree_util.tree_map_with_path(lambda path, _: _HARMLESS.get(path[-1].name, 1.0), used)
    used, of_design = status.admit(
        used,
        spare,
        (~_finite(used) | jnp.any((sizes > 0) & (sizes < 1 / _top(sizes))), Status.NONFINITE),
        (jnp.any(~(sizes > 0)) | negative(used), Status.INVALID_GEOMETRY),
    )
    refused = [*of_design.refused]
    admitted = []
    turns = jnp.where(jnp.abs(angle) < LARGEST_ANGLE, angle, jnp.nan)
    for number in (parts, torque, turns, (e, added)):
        number, gate = status.admit(number, 0, (~_finite(number), Status.NONFINITE))
        admitted.append(number)
        refused += gate.refused
    parts, torque, angle, (e, added) = admitted

    cycloid = used.cycloid
    e = e + added
    largest = cycloid.pin_circle_radius / cycloid.pin_count  # K1 = 1
    proper = (e > 0) & (e < largest)
    e = jnp.where(of_design.good & proper, e, 0.6 * largest)
    convex = cycloid.pin_circle_radius * least_convex_radius(e / largest, pins=cycloid.pin_count)
    convex = jax.lax.stop_gradient(convex)  # for a check only, no part of the result
    undercut = of_design.good & (cycloid.pin_radius >= convex)
    cycloid = cycloid.replace(pin_radius=jnp.where(undercut, 0.1 * convex, cycloid.pin_radius))
    gate = Gate((*refused, (~proper, Status.INVALID_GEOMETRY), (undercut, Status.UNDERCUT)))
    return Read(used.replace(cycloid=cycloid), parts, e, torque, angle, gate)


_HARMLESS = {
    "pressure_angle": 0.35,
    "poisson_ratio": 0.3,
    "pin_poisson_ratio": 0.3,
    "pin_radius": 1e-6,
    "equidistant_modification": 0.0,
    "shift_modification": 0.0,
    "profile_modification": 0.0,
}
"""Replacements of numbers of a design that the computation cannot use; any other becomes 1."""


def unchecked(part: Part, **changes: object) -> Part:
    """Copy of a record without its checks: inconsistent numbers give a status here, no error.

    Args:
        part: a record.
        **changes: fields by name.
    """
    copy = jax.tree.map(lambda leaf: leaf, part)
    for name, value in changes.items():
        object.__setattr__(copy, name, value)
    return copy


def _top(number: jax.Array) -> float:
    """Beyond it, or nearer to zero than one over it, squares and products leave the arithmetic."""
    return float(jnp.finfo(number.dtype).max) ** (1 / 3)


def _finite(tree: object) -> jax.Array:
    numbers = jnp.concatenate([jnp.ravel(leaf) for leaf in jax.tree.leaves(tree)])
    return jnp.all(jnp.abs(numbers) < _top(numbers))  # false for NaN


CARRIED = 0.03
"""Share of a torque on the bench that centring springs carry: the angle in the clearances is then right to 2e-4."""
STIFFEST = 1e7
"""Largest stiffness of a bearing on the bench, times the clearances over the load: more changes 1e-7 of the angle."""


class Case(NamedTuple):
    """One system, and what its results are derived with."""

    system: System
    lever: jax.Array  # (d, p) m, of a pin about the centre of its disc
    pressure: jax.Array  # (d, p) Pa / sqrt(N)
    length: jax.Array  # () m: the first common unknown over the rotation of the output
    size: jax.Array  # (d, p) S of Eq. 4
    hole_pressure: jax.Array | None = None  # (d, n) Pa / sqrt(N), of output pins
    eccentric: jax.Array | None = None  # (d, 2) direction of the eccentric of each disc
    most: jax.Array | None = None  # (j,) N, forces of joints beyond which the theory of their contact fails

    def loaded(self, torque: jax.Array) -> "Case":
        """The same parts, whose load is that of 1 N m, under `torque`, () N m."""
        return self._replace(system=self.system._replace(load=torque * self.system.load))

    def on_bench(self, torque: jax.Array) -> "Case":
        """`loaded`, but the angle of a small torque follows from the clearances, however stiff the bearings are.

        A centring spring carries at most a small share of the load across the clearances, and a bearing that yields
        less than a far smaller share of them counts as that stiff.
        """
        case = self.loaded(torque)
        s = case.system
        gaps = s.pins.gap, s.joints.gap, s.bearings.gap, s.bearings.clearance
        play = jnp.sum(jnp.stack([jnp.max(jnp.abs(gap)) for gap in gaps]))
        rate = jax.lax.stop_gradient(jnp.abs(s.load) / jnp.where(play > 0, play, 1))

        def limited(stiffness: jax.Array, most: float) -> jax.Array:
            return jnp.where((play > 0) & (rate > 0) & (stiffness > most * rate), most * rate, stiffness)

        bearings = s.bearings._replace(stiffness=limited(s.bearings.stiffness, STIFFEST))
        return case._replace(system=s._replace(bearings=bearings, centring=limited(s.centring, CARRIED)))


class NamedForces(NamedTuple):
    """Forces by their names in the results, N, and the torque on the input; None where a kind has none."""

    disc_bearing: jax.Array  # (d, c, 2) crank on disc
    support_bearing: jax.Array  # (c, 2) crank on carrier
    gear: jax.Array | None  # (c,) driving less coasting flank
    input_torque: jax.Array  # () N m
    output_pins: jax.Array | None = None  # (d, n) each output pin in each disc
    output_pressure: jax.Array | None = None  # (d, n) Pa
    output_bearing: jax.Array | None = None  # (2,) all discs on the carrier


def solve(layout: Layout, read: Read, case: Case, start: jax.Array) -> tuple[Minimum, SolveInfo]:
    """Minimum of the energy of a case, without derivatives, and its status; input that failed a check costs no step.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: the case.
        start: (n,), or NaN: none.
    """
    minimum = balance(layout, case.system, jnp.where(read.gate.good, start, jnp.inf))
    return minimum, _status(layout, read, case, minimum)


def _status(layout: Layout, read: Read, case: Case, minimum: Minimum) -> SolveInfo:
    """Status, steps and residual of the solve of a case.

    A torque so small that the centring springs carry it inside the clearances loads no contact. The forces are
    undetermined where the rounding of the gaps, times the stiffest spring, is not small compared with all forces.
    """
    faint = math.sqrt(float(jnp.finfo(minimum.residual.dtype).eps))
    idle = (case.system.load == 0) & (minimum.largest <= case.system.centring * read.design.cycloid.pin_radius)
    idle |= (minimum.largest <= faint * jnp.abs(case.system.load)) | (minimum.residual > faint)
    overload = minimum.overload & ~minimum.converged
    if any(group.discs for group in layout.joints):  # output pins press where the springs hold the discs, off the ring
        at = forces(layout, case.system, minimum.q)
        idle |= jnp.max(at.pins) <= faint * jnp.abs(case.system.load)
        if case.most is not None:
            overload |= jnp.any(at.joints > case.most)
    ended = SolveInfo(jnp.where(idle, jnp.int32(int(Status.UNLOADED)), 0), minimum.steps, minimum.residual)
    return read.gate.close(
        (),
        (~minimum.finite, Status.NONFINITE),
        (overload, Status.CONTACT_OVERLOAD),
        (~minimum.converged, Status.MAX_STEPS),
        info=ended,
    )[1]


def at_output(layout: Layout, case: Case, minimum: Minimum, status: jax.Array) -> jax.Array:
    """Displacements (n,) with the derivatives of the equilibrium; zero where it failed."""
    return with_implicit_derivative(layout, case.system, jnp.where(succeeded(status), minimum.q, 0))


def output_rotation(layout: Layout, case: Case, q: jax.Array) -> jax.Array:
    """Rotation of the output against the ideal motion, () rad."""
    return q[layout.carried] / case.length


def under(pressure: jax.Array, force: jax.Array) -> jax.Array:
    """Largest Hertzian pressure under a force, 0 without; Pa. Eq. 24.

    Args:
        pressure: over the square root of a force, Pa / sqrt(N).
        force: N.
    """
    pressed = force > 0
    return jnp.where(pressed, pressure * jnp.sqrt(jnp.where(pressed, force, 1)), 0)
