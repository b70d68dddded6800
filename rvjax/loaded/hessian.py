"""Second derivatives of the energy in blocks: of each disc, between discs and border, and of the border.

Arrays have the batch axis (independent cases) last; a leaf of the system that all cases share has length 1 there.
"""

import functools
import operator
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.kernels import folded
from rvjax.loaded.contacts import Contacts, over_pins
from rvjax.loaded.elimination import Hessian
from rvjax.loaded.system import Group, Layout, System

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
def hessian(layout: Layout, s: System, at: Contacts, at_rest: Frame | None = None) -> Hessian:
    """Second derivatives of the energy.

    Args:
        layout: counts and methods.
        s: the system, batch axis last.
        at: contacts at q.
        at_rest: `frame(layout, s)`, where it is known.
    """
    rows = frame(layout, s) if at_rest is None else at_rest
    found = defaultdict[str, list[jax.Array]](list)
    for touch, stiff in _groups(layout, at, rows):
        for name, block in _blocks(touch, stiff):
            found[name].append(block)
    centring = _DIAGONAL.astype(s.centring.dtype)[:, None, None] * s.centring[None, None]
    near = [_sum(found[name]) for name in ("disc link", "disc common") if name in found]
    return Hessian(
        disc=over_pins(rows.pins, at.pins.slope) + _sum(found["disc"]) + centring,
        bridge=near[0] if len(near) == 1 else jnp.concatenate(near, axis=2),
        border=_border(layout, s, found),
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


def _border(layout: Layout, s: System, found: Mapping[str, list[jax.Array]]) -> jax.Array:
    """Block of links and common bodies (m, m, l)."""
    links, size = layout.links, sum(layout.common)
    alike: dict[tuple[int, ...], jax.Array] = {}
    for block in found["common"]:  # groups of as many places in one reduction
        alike[block.shape] = alike[block.shape] + block if block.shape in alike else block
    common = _sum([folded(block, 2, 3) for block in alike.values()])
    support = s.support[layout.carried :] + s.centring[None]
    common = common + np.eye(size, dtype=common.dtype)[:, :, None] * support[:, None]
    if not links:
        return common
    link = _sum(found["link"]) + np.eye(3, dtype=common.dtype)[:, :, None, None] * s.centring[None, None, None]
    apart = np.eye(links, dtype=common.dtype)[:, None, :, None, None]  # links do not touch each other
    square = (apart * link.transpose(2, 0, 1, 3)[:, :, None]).reshape(3 * links, 3 * links, -1)
    bridge = jnp.moveaxis(_sum(found["link common"]), 2, 0).reshape(3 * links, size, -1)
    above = jnp.concatenate([square, bridge], axis=1)
    return jnp.concatenate([above, jnp.concatenate([bridge.swapaxes(0, 1), common], axis=1)])


def _outer(left: jax.Array, right: jax.Array) -> jax.Array:
    """Sum over the first axis of left (h, v, ..., l) times right (h, w, ..., l): (v, w, ..., l)."""
    # Not `folded`: it takes the same time with hertz pins, but a step with linear ones twice as long.
    return _sum([a[:, None] * b[None] for a, b in zip(left, right)])


def _sum(terms: Iterable[jax.Array]) -> jax.Array:
    return functools.reduce(operator.add, terms)
