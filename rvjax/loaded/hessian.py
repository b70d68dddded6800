"""Newton's linear system: second derivatives of the energy in blocks, and their elimination body by body.

Blocks are those of each disc, between discs and border, and of the border. Discs touch the border only, so that the
dense matrix is small. Every body has up to three unknowns and is factored as L D L', which stays exact to rounding
where a body is held by its centring springs alone.

Arrays have the batch axis (independent cases) last; arithmetic runs along it. A leaf of the system that all cases share
has length 1 there.
"""

import functools
import operator
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import folded, stored
from rvjax.loaded.system import Contacts, Group, Layout, System, over_pins


class Hessian(NamedTuple):
    """Second derivatives of the energy, batch axis last; discs touch the first `near` of m unknowns of the border."""

    disc: jax.Array  # (6, d, l): 00, 10, 11, 20, 21, 22
    bridge: jax.Array  # (3, d, near, l)
    border: jax.Array  # (m, m, l)


_OF_TRIANGLE = (0, 2, 5)  # of a triangle
_Block = list[list[jax.Array]]  # rows of the lower triangle of a small symmetric block


@functools.partial(jax.jit, static_argnums=0)  # traced once for each batch size
def solve(layout: Layout, hessian: Hessian, rhs: jax.Array) -> jax.Array:
    """x with H x = rhs.

    Args:
        layout: counts.
        hessian: H.
        rhs: (n, l).
    """
    discs, near, lanes = layout.discs, layout.near, rhs.shape[-1]
    inner = rhs[: layout.inner].reshape(discs, 3, lanes).transpose(1, 0, 2)  # (3, d, l)
    right = jnp.concatenate([hessian.bridge, inner[:, :, None]], axis=2)
    inverse = _inverse(_rows(hessian.disc), [hessian.disc[a] for a in _OF_TRIANGLE])
    forward = stored(_forward, _rows(hessian.disc), inverse, right)  # (3, d, near + 1, l)

    def left_by_discs(forward: jax.Array, inverse: list[jax.Array], border: jax.Array, outer: jax.Array) -> jax.Array:
        """System of the border, right side in the last column."""
        dense = jnp.concatenate([border[:near, :near], outer[:near]], axis=1)
        for a in range(3):
            for k in range(discs):
                dense = dense - (forward[a, k, :near] * inverse[a][k, None])[:, None] * forward[a, k, None]
        above = jnp.concatenate([dense[:, :-1], border[:near, near:], dense[:, -1:]], axis=1)
        return jnp.concatenate([above, jnp.concatenate([border[near:], outer[near:]], axis=1)])

    matrix = stored(left_by_discs, forward, inverse, hessian.border, rhs[layout.inner :, None])
    border = _eliminated(layout, matrix, [hessian.border[a, a] for a in range(len(hessian.border))])

    def of_discs(block: _Block, inverse: list[jax.Array], forward: jax.Array, border: jax.Array) -> jax.Array:
        left = forward[:, :, -1] - folded(forward[:, :, :-1] * border[None, None, :near], 2)
        return _backward(block, inverse, left).transpose(1, 0, 2).reshape(layout.inner, lanes)

    return jnp.concatenate([of_discs(_rows(hessian.disc), inverse, forward, border), border])


def _eliminated(layout: Layout, matrix: jax.Array, diagonal: list[jax.Array]) -> jax.Array:
    """Unknowns of the border from their system (m, m + 1, l), body by body; `diagonal`: the one with the discs held."""
    steps = []
    for size in (*[3] * layout.links, *layout.common):
        inverse = _inverse(_corner(matrix, size), diagonal[-len(matrix) :])
        forward, rest = stored(functools.partial(_reduced, size), matrix, inverse)
        steps.append((matrix, inverse, forward))
        matrix = rest
    found = jnp.zeros((0, matrix.shape[-1]), matrix.dtype)
    for step in reversed(steps):
        found = stored(_resolved, *step, found)
    return found


def _reduced(size: int, matrix: jax.Array, inverse: list[jax.Array]) -> tuple[jax.Array, jax.Array]:
    """L^-1 times the columns right of the first block, and the Schur complement in the rows below."""
    forward = _forward(_corner(matrix, size), inverse, matrix[:size, size:])
    rest = matrix[size:, size:]
    for a in range(size if len(rest) else 0):
        rest = rest - (forward[a, :-1] * inverse[a][None])[:, None] * forward[a, None]
    return forward, rest


def _resolved(matrix: jax.Array, inverse: list[jax.Array], forward: jax.Array, solution: jax.Array) -> jax.Array:
    """The unknowns of the first block before those that are found."""
    left = forward[:, -1]
    if len(solution):
        left = left - folded(forward[:, :-1] * solution[None], 1)
    return jnp.concatenate([_backward(_corner(matrix, len(inverse)), inverse, left), solution])


def _corner(matrix: jax.Array, size: int) -> _Block:
    return [[matrix[a, b] for b in range(a + 1)] for a in range(size)]


def _rows(triangle: jax.Array) -> _Block:
    """Rows of a lower triangle that is given in one axis."""
    return [[triangle[a * (a + 1) // 2 + b] for b in range(a + 1)] for a in range(3)]


def _factor(block: _Block, inverse: list[jax.Array]) -> tuple[_Block, list[jax.Array]]:
    """L below its diagonal and D of the first rows of a small symmetric block, 1 / D being known above the last."""
    lower: _Block = []
    pivots: list[jax.Array] = []
    for a in range(min(len(inverse) + 1, len(block))):
        row = list(block[a])  # row[b] becomes L[a][b] D[b]
        for b in range(1, a + 1):
            for s in range(b):
                row[b] = row[b] - row[s] * (lower[b][s] if b < a else row[s] * inverse[s])
        lower.append([row[b] * inverse[b] for b in range(a)])
        pivots.append(row[a])
    return lower, pivots


def _inverse(block: _Block, diagonal: list[jax.Array]) -> list[jax.Array]:
    """1 / D of L D L'; a pivot lost to rounding is raised to it. L is computed from it wherever it is used.

    Args:
        block: to be factored.
        diagonal: its diagonal before any body was eliminated, of which all that is left may be rounding.
    """
    least = 8 * float(jnp.finfo(block[0][0].dtype).eps)
    inverse: list[jax.Array] = []
    for a in range(len(block)):
        inverse.append(1 / jnp.maximum(_factor(block, inverse)[1][a], least * diagonal[a]))
    return inverse


def _forward(block: _Block, inverse: list[jax.Array], right: jax.Array) -> jax.Array:
    """L^-1 times the rows of `right` (size, ..., columns, l)."""
    rows: list[jax.Array] = []
    for a, weights in enumerate(_factor(block, inverse)[0]):
        row = right[a]
        for weight, above in zip(weights, rows):
            row = row - weight[..., None, :] * above
        rows.append(row)
    return jnp.stack(rows)


def _backward(block: _Block, inverse: list[jax.Array], left: jax.Array) -> jax.Array:
    """L'^-1 D^-1 times the rows of `left` (size, ..., l)."""
    lower = _factor(block, inverse)[0]
    rows = [left[a] * inverse[a] for a in range(len(lower))]
    for a in reversed(range(len(lower))):
        for b in range(a):
            rows[b] = rows[b] - lower[a][b] * rows[a]
    return jnp.stack(rows)


_PAIRS = ((0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2))
_DIAGONAL = np.asarray([a == b for a, b in _PAIRS])


class Touch(NamedTuple):
    """Rows of a group on the bodies that it touches: h rows of a place (x, y of a bearing; every joint) first.

    D discs and S links have such places, 1 where the group has none there. None: it touches no such body.
    """

    disc: jax.Array | None  # (h, 3, D, S, l)
    link: jax.Array | None  # (h, 3, D, S, l)
    common: jax.Array | None  # (h, t, D, S, l)
    pairs: tuple[jax.Array, jax.Array] | None  # (h, 6, D, S, l) rows of the disc, first and second of each pair


class Frame(NamedTuple):
    """Geometry in the second derivatives, which all steps share."""

    pins: jax.Array  # (6, d, p, l) products of two rows
    bearings: tuple[Touch, ...]
    joints: tuple[Touch, ...]


def frame(layout: Layout, s: System) -> Frame:
    """The geometry of the second derivatives.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
    """

    def touches(groups: tuple[Group, ...], rows: jax.Array) -> tuple[Touch, ...]:
        return tuple(_touch(layout, group, rows[part]) for group, part in layout.parts(groups))

    pins = jnp.stack([s.pins.rows[a] * s.pins.rows[b] for a, b in _PAIRS])
    return Frame(pins, touches(layout.bearings, s.bearings.rows), touches(layout.joints, s.joints.rows))


def _touch(layout: Layout, group: Group, rows: jax.Array) -> Touch:
    discs, links = layout.places(group)
    rows = rows.reshape(discs, links, -1, *rows.shape[-2:])  # (D, S, h, n, l)
    disc = link = common = pairs = None
    if group.discs:
        disc = jnp.moveaxis(jnp.stack([rows[k, :, :, 3 * k : 3 * k + 3] for k in range(discs)]), (2, 3), (0, 1))
        first, second = (jnp.stack([disc[:, pair[i]] for pair in _PAIRS], axis=1) for i in range(2))
        pairs = first, second
    if group.links:
        of_link = [rows[:, i, :, layout.link(i) : layout.link(i) + 3] for i in range(links)]
        link = jnp.moveaxis(jnp.stack(of_link, axis=1), (2, 3), (0, 1))
    if group.common:
        common = jnp.moveaxis(rows[:, :, :, layout.carried :], (2, 3), (0, 1))
    return Touch(disc, link, common, pairs)


@functools.partial(jax.jit, static_argnums=0)  # traced once for each batch size
def hessian(layout: Layout, s: System, at: Contacts, rows: Frame) -> Hessian:
    """Second derivatives of the energy.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        at: contacts at q.
        rows: `frame(layout, s)`.
    """
    blocks = defaultdict[str, list[jax.Array]](list)
    for touch, stiff in _groups(layout, at, rows):
        for name, block in _blocks(touch, stiff):
            blocks[name].append(block)
    centring = _DIAGONAL.astype(s.centring.dtype)[:, None, None] * s.centring[None, None]
    near = [_sum(blocks[name]) for name in ("disc link", "disc common") if name in blocks]
    return Hessian(
        disc=over_pins(rows.pins, at.pins.slope) + _sum(blocks["disc"]) + centring,
        bridge=near[0] if len(near) == 1 else jnp.concatenate(near, axis=2),
        border=_border(layout, s, blocks),
    )


_Stiff = Callable[[jax.Array], jax.Array]


def _groups(layout: Layout, at: Contacts, rows: Frame) -> Iterator[tuple[Touch, _Stiff]]:
    """Rows of each group, and the function that multiplies such rows by the stiffness of its contacts."""
    for (group, part), touch in zip(layout.parts(layout.bearings), rows.bearings):
        stiffness = at.bearings.stiffness[:, part]
        yield touch, functools.partial(_sprung, stiffness.reshape(3, 1, *layout.places(group), stiffness.shape[-1]))
    slope = at.joints.slope
    for (group, part), touch in zip(layout.parts(layout.joints), rows.joints):
        each = slope[part].reshape(*layout.places(group), group.each, slope.shape[-1])
        yield touch, functools.partial(operator.mul, jnp.moveaxis(each, 2, 0)[:, None])


def _sprung(stiffness: jax.Array, rows: jax.Array) -> jax.Array:
    """Stiffness xx, xy, yy (3, 1, ..., l) times rows (2, w, ..., l)."""
    xx, xy, yy = stiffness
    return jnp.stack([xx * rows[0] + xy * rows[1], xy * rows[0] + yy * rows[1]])


def _blocks(touch: Touch, stiff: _Stiff) -> Iterator[tuple[str, jax.Array]]:
    """Contributions of a group, by the bodies whose rows they are."""
    of_link = None if touch.link is None else stiff(touch.link)
    of_common = None if touch.common is None else stiff(touch.common)
    if touch.disc is not None and touch.pairs is not None:
        of_disc, (first, second) = stiff(touch.disc), touch.pairs
        yield "disc", folded(_sum(first * stiff(second)), 2)
        if touch.link is not None:
            block = jnp.moveaxis(_outer(of_disc, touch.link), 1, 3)  # (3, d, c, 3, l)
            yield "disc link", block.reshape(*block.shape[:2], -1, block.shape[-1])
        if touch.common is not None:
            yield "disc common", jnp.moveaxis(folded(_outer(of_disc, touch.common), 3), 1, 2)
    if touch.link is not None and of_link is not None:
        yield "link", folded(_outer(touch.link, of_link), 2)
        if of_common is not None:
            yield "link common", folded(_outer(touch.link, of_common), 2)
    if touch.common is not None and of_common is not None:
        yield "common", _outer(touch.common, of_common)


def _border(layout: Layout, s: System, blocks: Mapping[str, list[jax.Array]]) -> jax.Array:
    """Block of links and common bodies (m, m, l)."""
    links, size = layout.links, sum(layout.common)
    alike: dict[tuple[int, ...], jax.Array] = {}
    for block in blocks["common"]:  # groups of as many places in one reduction
        alike[block.shape] = alike[block.shape] + block if block.shape in alike else block
    common = _sum([folded(block, 2, 3) for block in alike.values()])
    support = s.support[layout.carried :] + s.centring[None]
    common = common + np.eye(size, dtype=common.dtype)[:, :, None] * support[:, None]
    if not links:
        return common
    link = _sum(blocks["link"]) + np.eye(3, dtype=common.dtype)[:, :, None, None] * s.centring[None, None, None]
    apart = np.eye(links, dtype=common.dtype)[:, None, :, None, None]  # links do not touch each other
    square = (apart * link.transpose(2, 0, 1, 3)[:, :, None]).reshape(3 * links, 3 * links, -1)
    bridge = jnp.moveaxis(_sum(blocks["link common"]), 2, 0).reshape(3 * links, size, -1)
    above = jnp.concatenate([square, bridge], axis=1)
    return jnp.concatenate([above, jnp.concatenate([bridge.swapaxes(0, 1), common], axis=1)])


def _outer(left: jax.Array, right: jax.Array) -> jax.Array:
    """Sum over the first axis of left (h, v, ..., l) times right (h, w, ..., l): (v, w, ..., l)."""
    # Not `folded`: it takes the same time with hertz pins, but a step with linear ones twice as long.
    return _sum([a[:, None] * b[None] for a, b in zip(left, right)])


def _sum(terms: Iterable[jax.Array]) -> jax.Array:
    return functools.reduce(operator.add, terms)
