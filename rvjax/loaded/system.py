"""Bodies and contacts of one equilibrium: counts that are compiled in, and the numbers of a case.

Unknowns q are lengths, deviations from the ideal motion; rotations are multiplied by a length of their body:

    disc k      three unknowns                  rows 3 k ..
    border      all other bodies: `links` bodies of three unknowns each (cranks), rows 3 discs ..; after them the
                common bodies, of which the first begins with the rotation of the carrier, which the load turns

A disc touches the border only, never another disc. A link touches discs and common bodies, never another link.
"""

from typing import Any, NamedTuple


class Group(NamedTuple):
    """Contacts of the same two kinds of bodies. They are numbered disc by disc, link by link, and at each place."""

    discs: bool  # there are contacts on every disc
    links: bool  # there are contacts on every link, or of every disc with every link
    common: bool  # the common bodies are touched
    each: int = 1  # at a place; of bearings 1
    law: str = "linear"  # of joints


class Layout(NamedTuple):
    """Counts and methods: what is compiled in."""

    discs: int
    pins: int  # round each disc
    law: str  # of the pins
    links: int
    common: tuple[int, ...]  # unknowns of each common body
    joints: tuple[Group, ...]  # one or more
    bearings: tuple[Group, ...]  # one or more
    interior: bool = True  # cases that Newton leaves go to the interior point method; not in tests that need none

    @property
    def inner(self) -> int:
        """Unknowns of the discs."""
        return 3 * self.discs

    @property
    def carried(self) -> int:
        """Row of the carrier rotation, the first of the common bodies."""
        return self.inner + 3 * self.links

    @property
    def unknowns(self) -> int:
        """Their number."""
        return self.carried + sum(self.common)

    @property
    def near(self) -> int:
        """Unknowns of the border that discs touch, its first ones."""
        touched = any(group.discs and group.common for group in (*self.joints, *self.bearings))
        return 3 * self.links + touched * sum(self.common)

    def link(self, i: int) -> int:
        """First row of a link."""
        return self.inner + 3 * i

    def places(self, group: Group) -> tuple[int, int]:
        """Discs and links on which a group has contacts; 1 where it has none of that kind."""
        return self.discs if group.discs else 1, self.links if group.links else 1

    def parts(self, groups: tuple[Group, ...]) -> list[tuple[Group, slice]]:
        """Each group with its part of the contacts of all."""
        found, end = list[tuple[Group, slice]](), 0
        for group in groups:
            discs, links = self.places(group)
            begin, end = end, end + discs * links * group.each
            found.append((group, slice(begin, end)))
        return found

    def contacts(self, groups: tuple[Group, ...]) -> int:
        """Number of contacts of all groups."""
        return sum(part.stop - part.start for _, part in self.parts(groups))


class Pins(NamedTuple):
    """Unilateral contacts of a disc with the ring. d discs, p pins."""

    rows: Any  # (3, d, p) depth per displacement of the disc; Eq. 9
    gap: Any  # (d, p) m, depth at q = 0
    compliance: Any  # (1,) of the contact law; (p,) where the supports of linear pins differ
    level: Any  # (d, p) A of the hertz contact law, else None


class Joints(NamedTuple):
    """Unilateral contacts of any two bodies, j of all groups, n unknowns."""

    rows: Any  # (j, n) depth per unknown
    gap: Any  # (j,) m, depth at q = 0
    compliance: Any  # (j,) of the contact law of their group
    level: Any  # (j,) A of the hertz contact law; None without such a group
    lever: Any  # (j,) < 0 where a positive load presses; its size weights the shares in the load


class Bearings(NamedTuple):
    """Springs k (|w| - clearance)+ along w = gap + rows q, b of all groups."""

    rows: Any  # (b, 2, n)
    gap: Any  # (b, 2) m, bore against journal at q = 0
    stiffness: Any  # (b,) N/m
    clearance: Any  # (b,) m, >= 0


class System(NamedTuple):
    """Numbers of one case, lengths in m, forces in N."""

    pins: Pins
    joints: Joints
    bearings: Bearings
    centring: Any  # () k0, N/m, of every unknown
    support: Any  # (n,) N/m, springs of the common bodies against the housing, besides k0
    load: Any  # () N, torque over the length of the carrier rotation
