"""One case between the numbers that are read and the results of an equilibrium.

An equilibrium, from the call to the result:

     1  layout = check_input(design, errors, contact, ..)      on the host: counts and methods, static
     2  jit(_equilibrium), layout static                       `quick`; a part of the user's program inside `jax.jit`
     3      read = admit(layout, design, errors, torque, ..)   harmless numbers where given ones are impossible
     4      case = prepare(layout, read, angle).loaded(torque) geometry, gaps, springs: a `System`
     5      found = balance(layout, case.system, start)        without derivatives, in a `BatchedKernel`: a primitive
     6          for each block of waiting cases:               that is traced when the program is lowered, and whose
     7              while a case is open:                      batch axis joins all levels of `jax.vmap`
     8                  contacts, gradient and Hessian at q, Newton's step from there
     9                  rows = decided(rows, merit), q = onward(..)        full step, or a point of a line
    10      q = placed(layout, case, found, status)            dq = -H^-1 d(grad E): its `custom_jvp`, two kernels more
    11      pins, joints, bearings = forces(layout, case.system, q)        a `BatchedKernel`, too
    12      return Loaded(..), NaN where the status is none of success

The state of line 7 has the cases of a block last (l). A row of `q` (n, l) is an unknown: three for each disc, then
those of the border, see `system`. A row of `rows` is a field of `line_search.Element`: numbers (energy, bracket,
residual) in one array, counts and marks in the other.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded.balance import attach, balance, forces
from rvjax.loaded.inputs import Read
from rvjax.loaded.newton import Found
from rvjax.loaded.system import Layout, System
from rvjax.status import SolveInfo, Status, succeeded

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
    hole_pressure: jax.Array | None = None  # (d, n) Pa / sqrt(N), of output pins
    eccentric: jax.Array | None = None  # (d, 2) direction of the eccentric of each disc
    size: jax.Array | None = None  # (d, p) S of Eq. 4
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


class Named(NamedTuple):
    """Forces by their names in the results, N, and the torque on the input; None where a kind has none."""

    disc_bearing: jax.Array  # (d, c, 2) crank on disc
    support_bearing: jax.Array  # (c, 2) crank on carrier
    gear: jax.Array | None  # (c,) driving less coasting flank
    input_torque: jax.Array  # () N m
    output_pins: jax.Array | None = None  # (d, n) each output pin in each disc
    output_pressure: jax.Array | None = None  # (d, n) Pa
    output_bearing: jax.Array | None = None  # (2,) all discs on the carrier


def solve(layout: Layout, read: Read, case: Case, start: jax.Array) -> tuple[Found, SolveInfo]:
    """Minimum of the energy of a case, without derivatives, and its status; input that failed a check costs no step.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: the case.
        start: (n,), or NaN: the linear step.
    """
    found = balance(layout, case.system, jnp.where(read.gate.good, start, jnp.inf))
    return found, _status(layout, read, case, found)


def _status(layout: Layout, read: Read, case: Case, found: Found) -> SolveInfo:
    """Status, steps and residual of the solve of a case.

    A torque so small that the centring springs carry it inside the clearances loads no contact. The forces are
    undetermined where the rounding of the gaps, times the stiffest spring, is not small compared with all forces.
    """
    faint = math.sqrt(float(jnp.finfo(found.residual.dtype).eps))
    idle = (case.system.load == 0) & (found.largest <= case.system.centring * read.design.cycloid.pin_radius)
    idle |= (found.largest <= faint * jnp.abs(case.system.load)) | (found.residual > faint)
    overload = found.overload & ~found.converged
    if any(group.discs for group in layout.joints):  # output pins press where the springs hold the discs, off the ring
        at = forces(layout, case.system, found.q)
        idle |= jnp.max(at.pins) <= faint * jnp.abs(case.system.load)
        if case.most is not None:
            overload |= jnp.any(at.joints > case.most)
    ended = SolveInfo(jnp.where(idle, jnp.int32(int(Status.UNLOADED)), 0), found.steps, found.residual)
    return read.gate.close(
        (),
        (~found.finite, Status.NONFINITE),
        (overload, Status.CONTACT_OVERLOAD),
        (~found.converged, Status.MAX_STEPS),
        info=ended,
    )[1]


def placed(layout: Layout, case: Case, found: Found, status: jax.Array) -> jax.Array:
    """Displacements (n,) with the derivatives of the equilibrium; zero where it failed."""
    return attach(layout, case.system, jnp.where(succeeded(status), found.q, 0))


def turned(layout: Layout, case: Case, q: jax.Array) -> jax.Array:
    """Rotation of the output against the ideal motion, () rad."""
    return q[layout.carried] / case.length


def pressures(case: Case, pins: jax.Array) -> jax.Array:
    """Largest Hertzian pressure of each pin under its force, (d, p) Pa. Eq. 24.

    Args:
        case: of the same angle.
        pins: forces (d, p) N.
    """
    return under(case.pressure, pins)


def under(pressure: jax.Array, force: jax.Array) -> jax.Array:
    """Pressure under a force, 0 without; Pa.

    Args:
        pressure: over the square root of a force, Pa / sqrt(N).
        force: N.
    """
    pressed = force > 0
    return jnp.where(pressed, pressure * jnp.sqrt(jnp.where(pressed, force, 1)), 0)
