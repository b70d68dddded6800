"""Harmonic balance of errors, load and the varying mesh stiffness of one stage.

The stiffness of P orders per output turn, P = planet_teeth pins or disc_teeth pins, ties an error of order r to the
orders r + l P. Each residue r in [0, P/2] is a separate system, l = -H .. H; negative orders are conjugates. With the
deflections d_il = v_i.Q_l - delta_il of the varying meshes (mesh form, as in harmonic_balance.py)

    d_il - sum_m G_l[i, m] u_ml = v_i.Q0_l - delta_il,   u_il = -k sum_{j != l} a_|l-j|/2 e^{i (l - j) ph_i} d_ij,
    Q_l = Q0_l + Z_l^-1 sum_i v_i u_il,

Q0 the linear response to load and errors. Sun and output turn counter-clockwise, so that a later planet, or disc, meets
a tooth later: ph_i = -2 pi zs (i-1) / M, -2 pi Zp (j-1) / N, for either sense of rotation, because the phase goes with
theta and not with time.
"""

from collections.abc import Iterator
from fractions import Fraction
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.dynamics.assembly import Lumped, spring_table, waves
from rvjax.dynamics.error_excitation import (
    SPRINGS,
    Orders,
    Unit,
    error_orders,
    generators,
    length,
    planet_series,
    sun_order,
    turned,
    vector,
)
from rvjax.dynamics.error_transfer import KEY, Balanced, output_rows, rotations, static_deflection, transfer
from rvjax.dynamics.excitation import MESH, constants, mesh_count, phases, wave_coefficients
from rvjax.dynamics.modes import dynamic_stiffness, modal_sectors, modal_solve, on_resonance, residual
from rvjax.dynamics.static import balancing_torque, linear_ratio, mean_state, mesh_rows, mesh_stiffness, solve

WHOLE = ("coupled", 0)


class Lattice(NamedTuple):
    """Signed orders that one residue ties together: residue + l period, l = -H .. H."""

    period: int
    residues: tuple[Fraction, ...]  # 0 first, where the load acts
    harmonics: int

    def order(self, residue: int, place: int) -> Fraction:
        """Signed order at a place 0 .. 2 H of a residue."""
        return self.residues[residue] + (place - self.harmonics) * self.period

    def places(self, order: Fraction) -> Iterator[tuple[int, int, bool]]:
        """Positions at which a line acts: residue, place, and True for its conjugate (at minus its order).

        Raises:
            ValueError: too far from the others.
        """
        for signed in (order, -order):
            step, left = divmod(signed, self.period)
            if left in self.residues and not self.is_apart(left, int(step) + self.harmonics):
                if not -self.harmonics <= step <= self.harmonics:
                    raise ValueError(f"harmonics = {self.harmonics}: an error of order {order} needs {abs(int(step))}")
                yield self.residues.index(left), int(step) + self.harmonics, signed < 0

    def is_apart(self, residue: Fraction, place: int) -> bool:
        """Half a period is its own mirror image: its last order has no partner and stays out."""
        return 2 * residue == self.period and place == 2 * self.harmonics


def lattice(orders: Orders, period: int, harmonics: int) -> Lattice:
    """Return the residues that lines at `orders` and the stiffness excite."""
    residues = {min(n % period, -n % period) for n in orders}
    return Lattice(period, (Fraction(0), *sorted(residues - {Fraction(0)})), harmonics)


def balance(
    unit: Unit,
    speed: jax.Array,
    output_torque: jax.Array,
    outputs: tuple[str, ...],
    pin_harmonics: int,
    stage: str,
    harmonics: int,
) -> Balanced:
    """All lines at output speed `speed`, () rad/s, under a torque on the output."""
    lumped, mesh = unit.lumped, MESH[stage]
    orders = error_orders(unit, pin_harmonics)
    amplitude, constant = generators(unit, orders, pin_harmonics)
    own, meshes = _mesh_displacement(unit, stage, orders, amplitude)
    teeth = lumped.planet_teeth if stage == "planetary" else lumped.disc_teeth
    tied = lattice(tuple(sorted({*orders, *own})), teeth * (lumped.disc_teeth + 1), harmonics)

    # Errors on the lattice, two-sided: those of the varying meshes one by one, the others as signals of their springs.
    others = amplitude.at[:, SPRINGS.index(mesh)].set(0)
    delta = _on_lattice(tied, own, meshes)
    signal = _on_lattice(tied, orders, others)
    zero = (0, harmonics)
    signal = signal.at[zero].add(constants(constant, speed).at[SPRINGS.index(mesh)].set(0))
    delta = delta.at[zero].add(constants(constant[SPRINGS.index(mesh)], speed))

    signed = np.array([[float(tied.order(r, p)) for p in range(2 * harmonics + 1)] for r in range(len(tied.residues))])
    rest = signed == 0
    frequency = jnp.asarray(np.where(rest, 1.0, signed), speed.dtype) * speed
    linear = _linear(lumped, frequency, outputs, mesh, output_torque, rest)
    damper = jnp.where(rest, constants(1, speed), _complex_stiffness(lumped, frequency))
    driven = delta * (mesh_stiffness(lumped, mesh).astype(delta.dtype)[None, None, :] * damper[:, :, None])
    still = constants(rest[:, :, None], speed)
    deflection = jnp.einsum("cpis,cps->cpi", linear.mesh_signal, signal) + linear.mesh_load[None, None, :] * still
    deflection += jnp.einsum("cpim,cpm->cpi", linear.gamma, driven)
    shown = jnp.einsum("cpos,cps->cpo", linear.output_signal, signal) + linear.output_load[None, None, :] * still
    shown += jnp.einsum("cpom,cpm->cpo", linear.shown, driven)

    force, pivot = _coupling(lumped, stage, tied, linear.gamma, deflection - delta)
    motion = shown + jnp.einsum("cpom,cpm->cpo", linear.shown, force)
    lines, rows = _one_sided(tied, motion)
    standing = (output_rows(lumped, outputs) @ static_deflection(lumped)[0]).T.astype(amplitude.dtype)
    places = np.array([lines.index(n) for n in orders])
    return Balanced(
        orders=lines,
        amplitude=rows,
        static=jnp.zeros_like(rows).at[places].set(amplitude @ standing),
        singular=linear.singular | jnp.logical_not(pivot > 16 * float(jnp.finfo(pivot.dtype).eps)) | (speed == 0),
        residual=linear.residual,
    )


def _mesh_displacement(unit: Unit, stage: str, orders: Orders, amplitude: jax.Array) -> tuple[Orders, jax.Array]:
    """Errors of each varying mesh: orders, and phasors (orders, meshes)."""
    lumped, errors = unit.lumped, unit.errors
    if stage == "cycloid":  # the mean acts on every disc
        values = amplitude[:, SPRINGS.index(MESH[stage])]
        return orders, jnp.broadcast_to(values[:, None], (len(orders), lumped.discs))
    pins, sun, cranks = lumped.disc_teeth + 1, sun_order(lumped), lumped.cranks
    ahead = turned(-lumped.pressure_angle)
    runout = jnp.broadcast_to(1j * ahead * vector(errors["planet_runout"]).conj(), (cranks,))
    # -z e^{-i (pi/2 - alpha)} e^{-i psi_i}, z negated into the frame of crank 0
    eccentric = -1j * ahead.conj() * vector(errors["sun_runout"]) * constants(waves(cranks, -1), runout.real)
    terms = [(Fraction(pins), runout), (sun, eccentric)]
    terms += [
        (Fraction(h * pins), planet_series(unit)[:, h - 1]) for h in range(1, length(errors["planet_flank"], -2) + 1)
    ]
    for h in range(1, length(errors["sun_flank"], -2) + 1):
        met = constants(waves(cranks, -h), runout.real)
        terms.append((h * sun, -vector(errors["sun_flank"])[h - 1] * met))
    return tuple(order for order, _ in terms), jnp.stack([values for _, values in terms])


def _on_lattice(tied: Lattice, orders: Orders, values: jax.Array) -> jax.Array:
    """Lines (orders, k) as two-sided coefficients (residues, 2 H + 1, k): half of each, and of its conjugate."""
    spread = jnp.zeros((len(tied.residues), 2 * tied.harmonics + 1, values.shape[1]), values.dtype)
    for number, order in enumerate(orders):
        for residue, place, mirrored in tied.places(order):
            own = values[number].conj() if mirrored else values[number]
            spread = spread.at[residue, place].add(own / 2)
    return spread


def _one_sided(tied: Lattice, motion: jax.Array) -> tuple[Orders, jax.Array]:
    """Lines at positive orders, ascending, from two-sided coefficients (residues, 2 H + 1, k)."""
    places_of = {}
    for residue, least in enumerate(tied.residues):
        for place in range(2 * tied.harmonics + 1):
            order = tied.order(residue, place)
            if order != 0 and not tied.is_apart(least, place) and (abs(order) not in places_of or order > 0):
                places_of[abs(order)] = (residue, place, order < 0)
    lines = tuple(sorted(places_of))
    residues, places, mirrored = (np.array(column) for column in zip(*(places_of[n] for n in lines)))
    rows = 2 * motion[residues, places]
    return lines, jnp.where(mirrored[:, None], rows.conj(), rows)


class Linear(NamedTuple):
    """The reducer at mean stiffness on the lattice: residues c, places p, meshes i and m, outputs o, springs s."""

    gamma: jax.Array  # (c, p, i, m): deflection of mesh i for unit force in mesh m
    shown: jax.Array  # (c, p, o, m)
    mesh_signal: jax.Array  # (c, p, i, s): for unit displacement of each kind of spring
    output_signal: jax.Array  # (c, p, o, s)
    mesh_load: jax.Array  # (i,): under the mean load
    output_load: jax.Array  # (o,)
    singular: jax.Array  # () bool
    residual: jax.Array  # ()


def _linear(
    lumped: Lumped, frequency: jax.Array, outputs: tuple[str, ...], mesh: str, torque: jax.Array, rest: np.ndarray
) -> Linear:
    """Linear responses at frequencies (c, p); at order 0, `rest`, those of statics."""
    shape, flat = frequency.shape, frequency.ravel()
    members = spring_table(lumped.cranks, lumped.discs).of(mesh)
    modal = modal_sectors(lumped, [WHOLE])[WHOLE]
    z = dynamic_stiffness(lumped, flat)
    dtype = z.scalar.dtype
    springs = modal.springs[members].astype(dtype)
    rhs = jnp.broadcast_to(springs.T[None], (len(flat), *springs.T.shape))
    x = modal_solve(modal, z, rhs)
    last = len(modal.basis) - 1
    sun, output = modal.rows([2, last])
    central = rotations(outputs, sun, output, linear_ratio(lumped))

    rows = mesh_rows(lumped, mesh, *WHOLE)
    state = mean_state(lumped, WHOLE[0], balancing_torque(lumped, torque), torque, rows.T)
    seen = rotations(outputs, state.solution[2], state.solution[last], linear_ratio(lumped))
    gamma = jnp.einsum("ir,frm->fim", springs, x).reshape(*shape, len(members), len(members))
    shown = jnp.einsum("or,frm->fom", central.astype(dtype), x).reshape(*shape, len(outputs), len(members))
    still = jnp.asarray(rest)[:, :, None, None]

    # Signals of springs reach everything through what is common to the members.
    common = jnp.concatenate([mesh_rows(lumped, mesh, *KEY)[:1], output_rows(lumped, outputs)])
    signals = transfer(lumped, flat, common)
    standing = (common @ static_deflection(lumped)[0]).astype(dtype)
    value = jnp.where(still, standing[None, None], signals.value.reshape(*shape, *signals.value.shape[1:]))
    first = value[:, :, :1]
    return Linear(
        gamma=jnp.where(still, (rows @ state.solution[:, 1:]).astype(dtype)[None, None], gamma),
        shown=jnp.where(still, seen[:, 1:].astype(dtype)[None, None], shown),
        mesh_signal=jnp.broadcast_to(first, (*shape, len(members), first.shape[3])),
        output_signal=value[:, :, 1:],
        mesh_load=(rows @ state.solution[:, 0]).astype(dtype),
        output_load=seen[:, 0].astype(dtype),
        singular=state.singular | on_resonance(modal, z) | signals.singular,
        residual=jnp.maximum(jnp.maximum(state.residual, residual(modal, z, x, rhs)), signals.residual),
    )


def _complex_stiffness(lumped: Lumped, frequency: jax.Array) -> jax.Array:
    """Spring with its damper over the spring: 1 + i eta sign(w) + i w b."""
    damping = lumped.damping
    loss = damping.loss_factor * jnp.sign(frequency) + damping.rayleigh_stiffness * frequency
    return jax.lax.complex(jnp.ones_like(loss), loss)


def _coupling(
    lumped: Lumped, stage: str, tied: Lattice, gamma: jax.Array, deflection: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Forces u (c, p, m) of the varying part of the meshes, and the smallest pivot.

    In d_il = e^{i l ph_i} D_il the products are a real convolution: D_l + Gamma_l k (T D)_l = e^{-i l ph} deflection_l.
    """
    order = np.arange(-tied.harmonics, tied.harmonics + 1)
    wave = constants(phases(lumped, stage, -order), deflection.real)  # minus: a later member meets the tooth later
    half = wave_coefficients(lumped, stage, 2 * tied.harmonics) / 2
    t = jnp.concatenate([jnp.zeros_like(half[:1]), half])[np.abs(order[:, None] - order)]
    k = mesh_stiffness(lumped, MESH[stage])
    size = len(order) * mesh_count(lumped, stage)

    def one(apart: jax.Array, gamma: jax.Array, deflection: jax.Array) -> tuple[jax.Array, jax.Array]:
        kept = jnp.where(apart[:, None] | apart[None, :], 0, t)
        turned_gamma = wave.conj()[:, :, None] * gamma * wave[:, None, :]
        block = jnp.einsum("lim,lj->lijm", turned_gamma * k.astype(wave.dtype)[None, None, :], kept.astype(wave.dtype))
        block = jnp.eye(size, dtype=wave.dtype) + block.reshape(size, size)
        rhs = (wave.conj() * deflection).ravel()
        matrix = jnp.block([[block.real, -block.imag], [block.imag, block.real]])
        scale = 1 / jax.lax.stop_gradient(jnp.max(jnp.abs(matrix), axis=1, keepdims=True))
        unknown, pivot = solve(scale * matrix, scale * jnp.concatenate([rhs.real, rhs.imag])[:, None])
        solution = jax.lax.complex(*unknown.reshape(2, *wave.shape))
        return -wave * k.astype(wave.dtype)[None, :] * (kept.astype(wave.dtype) @ solution), pivot

    apart = np.array([[tied.is_apart(r, p) for p in range(len(order))] for r in tied.residues])
    force, pivot = jax.vmap(one)(jnp.asarray(apart), gamma, deflection)
    return force, jnp.min(pivot)
