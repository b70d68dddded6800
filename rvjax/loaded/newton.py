"""The minimum of the energy for a block of cases: Newton's method, lanes last.

Full steps; only after four without a new lowest energy a lane returns to its best point and searches the line from there
(its slope is monotone, because the energy is convex). An immediate search fails where a journal slides round its
clearance: it leaves the circle by the second order, so that the energy of good steps rises for a while.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from rvjax.loaded import laws
from rvjax.loaded.contacts import Contacts, contacts, energy, gradient, hessian
from rvjax.loaded.elimination import solve
from rvjax.loaded.system import Layout, System

MAX_STEPS = 200
_PATIENCE = 4  # full steps without a new lowest energy
_SEARCHES = 30  # points on a line at most


class Found(NamedTuple):
    """Where the iteration ended, lanes last."""

    q: jax.Array  # (n, l)
    steps: jax.Array  # (l,)
    residual: jax.Array  # (l,) gradient over the largest force
    converged: jax.Array  # (l,)
    overload: jax.Array  # (l,) a pin beyond its law at the start, or in the way to the minimum
    finite: jax.Array  # (l,)
    open: jax.Array  # (l,) unfinished, q is the best point so far


class _State(NamedTuple):
    q: jax.Array
    best: jax.Array
    step: jax.Array  # Newton's step from the best point
    lowest: jax.Array  # energy there
    descent: jax.Array  # slope there along the step, < 0
    first: jax.Array  # slope after the full step
    stall: jax.Array  # points since the best
    searching: jax.Array
    lower: jax.Array  # the line: share of the step, slope
    lower_slope: jax.Array
    upper: jax.Array
    upper_slope: jax.Array
    share: jax.Array
    found: Found


def linear_start(layout: Layout, s: System) -> jax.Array:
    """Displacements (n, l) with the contacts that a torque of this sign closes, linear and without clearance."""
    size = s.gap.shape[-1]
    lanes = max(leaf.shape[-1] for leaf in jax.tree.leaves(s)) if size == 1 else size
    zero = jnp.zeros((layout.unknowns, lanes), s.gap.dtype)
    load = jnp.broadcast_to(s.load, (lanes,))
    # Mean force of the working pins: half of them, lever R rows[2] on average, each disc with its share.
    lever = jnp.sum(jnp.abs(s.rows[2]), axis=(0, 1)) / 2
    slope = laws.typical_slope(
        layout.law, (jnp.abs(load) / lever)[None, None], s.compliance[None, None], s.level
    )  # (., ., l)
    forward = load > 0
    working = (s.rows[2] < 0) == forward[None, None]
    pin_slope = jnp.where(working, slope, 0) * jnp.ones((layout.discs, layout.pins, lanes), zero.dtype)
    s = s._replace(arm_clearance=jnp.zeros_like(s.arm_clearance), seat_clearance=jnp.zeros_like(s.seat_clearance))
    at = contacts(layout, s, zero)
    drives = jnp.stack([forward, ~forward])[None]  # (1, 2, l)
    shape = (layout.cranks, 2, lanes)
    at = at._replace(
        pins=pin_slope * at.depth,
        gear=jnp.where(drives, s.mesh_stiffness[:, None] * jnp.broadcast_to(at.gear_depth, shape), 0),
    )
    g = gradient(layout, s, zero, at)
    at = at._replace(gear_depth=jnp.broadcast_to(jnp.where(drives, 1.0, -1.0).astype(zero.dtype), shape))
    q = solve(layout, hessian(layout, s, zero, at, pin_slope), -g)
    return jnp.where((load == 0)[None], 0, q)


def minimise(layout: Layout, s: System, start: jax.Array, leave: int = 0) -> Found:
    """The minimum of the energy.

    Args:
        layout: counts and methods.
        s: the system, lanes last.
        start: (n, l).
        leave: the loop ends early when no more lanes than this are unfinished.
    """
    lanes = start.shape[-1]
    limit = laws.largest_depth(s.compliance[None, None], s.level) if layout.law == "hertz" else None
    eps = float(jnp.finfo(start.dtype).eps)
    stiffest = _largest(*(jnp.max(k, axis=tuple(range(k.ndim - 1))) for k in (s.arm_stiffness, s.mesh_stiffness)))
    stiffest = _largest(stiffest, jnp.max(s.seat_stiffness, axis=0))
    widest = _largest(*(jnp.max(jnp.abs(g), axis=tuple(range(g.ndim - 1))) for g in (s.gap, s.gear_gap, s.arm, s.seat)))

    def running(state: _State) -> jax.Array:
        return jnp.sum(state.found.open) > leave

    def body(state: _State) -> _State:
        q = state.q
        at = contacts(layout, s, q)
        g = gradient(layout, s, q, at)
        newton = -solve(layout, hessian(layout, s, q, at), g)
        value = energy(layout, s, q, at)
        over = jnp.zeros((lanes,), bool) if limit is None else jnp.any(at.depth >= limit, axis=(0, 1))
        fine = jnp.isfinite(value) & jnp.all(jnp.isfinite(newton), axis=0)
        size = _largest_force(s, at, g)
        miss = jnp.max(jnp.abs(g), axis=0)
        rounding = stiffest * jnp.maximum(widest, jnp.max(jnp.abs(q), axis=0))
        done = fine & ~over & (miss <= jnp.maximum(450 * eps * size, 2 * eps * rounding))

        begins = jnp.isinf(state.lowest)
        lower_energy = fine & ~over & (value < state.lowest)
        slope = jnp.where(over | ~fine, jnp.inf, jnp.sum(state.step * g, axis=0))
        flat = jnp.abs(slope) <= 0.5 * jnp.abs(state.descent)
        exhausted = state.stall >= _PATIENCE + _SEARCHES
        take = jnp.where(state.searching, (flat & (lower_energy | (slope <= 0))) | exhausted, lower_energy)
        first = jnp.where(state.stall == 0, slope, state.first)
        stall = jnp.where(take, 0, state.stall + 1)
        enters = ~take & ~state.searching & ((stall >= _PATIENCE) | over | ~fine)
        searching = ~take & (state.searching | enters)

        best, step = jnp.where(take[None], q, state.best), jnp.where(take[None], newton, state.step)
        # The line: shares with negative slope below, with positive slope above.
        down = slope < 0
        lower = jnp.where(enters, 0, jnp.where(down, state.share, state.lower))
        lower_slope = jnp.where(enters, state.descent, jnp.where(down, slope, state.lower_slope))
        upper = jnp.where(enters, 1, jnp.where(down, state.upper, state.share))
        upper_slope = jnp.where(enters, first, jnp.where(down, state.upper_slope, slope))
        secant = lower_slope / (lower_slope - upper_slope)
        secant = jnp.where(jnp.isfinite(upper_slope) & (upper_slope > 0), jnp.clip(secant, 0.05, 0.95), 0.25)
        share = lower + (upper - lower) * secant
        onward = jnp.where(searching[None], best + share[None] * step, q + newton)

        failed = begins & (over | ~fine)
        steps = state.found.steps + 1
        live = state.found.open
        goes_on = live & ~done & ~failed & (steps < MAX_STEPS)
        found = Found(
            q=jnp.where(live[None], jnp.where(done[None], q + newton, jnp.where(failed[None], 0, best)), state.found.q),
            steps=jnp.where(live & ~done, steps, state.found.steps),
            residual=jnp.where(live, miss / jnp.where(size > 0, size, 1), state.found.residual),
            converged=jnp.where(live, done, state.found.converged),
            overload=jnp.where(live, (state.found.overload | over) & ~done, state.found.overload),
            finite=jnp.where(live, fine | over | ~begins, state.found.finite),
            open=goes_on,
        )
        new = _State(
            q=onward,
            best=best,
            step=step,
            lowest=jnp.where(take, value, state.lowest),
            descent=jnp.where(take, jnp.sum(newton * g, axis=0), state.descent),
            first=first,
            stall=stall,
            searching=searching,
            lower=lower,
            lower_slope=lower_slope,
            upper=upper,
            upper_slope=upper_slope,
            share=share,
            found=found,
        )
        kept = [jnp.where(goes_on[None] if a.ndim == 2 else goes_on, a, b) for a, b in zip(new[:-1], state[:-1])]
        return _State(*kept, found)

    zero = jnp.zeros((lanes,), start.dtype)
    no, none = jnp.zeros((lanes,), bool), jnp.zeros((lanes,), jnp.int32)
    found = Found(start, none, zero, no, no, no, ~no)
    state = _State(
        start, start, jnp.zeros_like(start), zero + jnp.inf, zero, zero, none, no, zero, zero, zero, zero, zero, found
    )
    return jax.lax.while_loop(running, body, state).found


def _largest(*values: jax.Array) -> jax.Array:
    largest = values[0]
    for value in values[1:]:
        largest = jnp.maximum(largest, value)
    return largest


def _largest_force(s: System, at: Contacts, g: jax.Array) -> jax.Array:
    def most(force: Any) -> jax.Array:
        return jnp.max(jnp.abs(force), axis=tuple(range(force.ndim - 1)))

    return _largest(most(at.pins), most(at.gear), most(at.arm.force), most(at.seat.force))
