"""Kinds of reducers under load: one table, and what every equilibrium begins with."""

from typing import Protocol

import jax

from rvjax.base.words import choose
from rvjax.cycloidal import CycloidalReducer
from rvjax.designs import RVReducer, expect
from rvjax.errors import Errors
from rvjax.loaded import cycloidal, laws, rv
from rvjax.loaded.balance import Forces
from rvjax.loaded.case import SUPPORTS, Case, NamedForces, Read, check_shapes, check_teeth
from rvjax.loaded.system import Layout
from rvjax.records import Design, PyTree, Scalar
from rvjax.status import SolveInfo


class LoadedKind(Protocol):
    """Functions of the module of a kind of reducer; the arguments are those of `rv`."""

    def layout(self, design: PyTree, errors: PyTree, contact: str, carrier: str, sun: str) -> Layout:
        """Bodies and contacts, with an error for shapes that do not fit."""

    def admit(self, layout: Layout, design: PyTree, errors: PyTree, torque: Scalar, angle: Scalar) -> Read:
        """The numbers that are read, harmless ones in the place of impossible ones."""

    def prepare(self, layout: Layout, read: Read, input_angle: jax.Array) -> Case:
        """Geometry, springs and gaps of one input angle; `load` is that of 1 N m."""

    def named_forces(self, layout: Layout, read: Read, case: Case, forces: Forces) -> NamedForces:
        """The forces by their names in the results."""

    def fit(
        self, samples: int, turns: float, design: PyTree, errors: PyTree
    ) -> tuple[tuple[jax.Array, jax.Array], SolveInfo]:
        """Least clearance without load, of all angles () and of each (n,)."""

    def passing(self, design: PyTree) -> tuple[int, ...]:
        """Orders of the output turn that a reducer without errors makes, as far as few angles may not resolve them."""


KINDS: dict[type, LoadedKind] = {RVReducer: rv, CycloidalReducer: cycloidal}


def kind_of(design: Design) -> LoadedKind:
    """The module of a design's kind."""
    return next(kind for cls, kind in KINDS.items() if isinstance(design, cls))


def check_kind(design: Design, errors: Errors) -> None:
    """Raise an error for errors of another kind of reducer or of other counts.

    Args:
        design: one of `KINDS`.
        errors: of its parts.
    """
    wanted = design.error_record
    if not isinstance(errors, wanted):
        kind = type(design).__name__
        raise ValueError(f"errors: a {kind} takes {wanted.__name__}, got {type(errors).__name__}")
    check_shapes([errors], design.counts)


def check_input(design: PyTree, errors: PyTree, contact: str, carrier: str, sun: str) -> Layout:
    """The layout of this call.

    Args:
        design: as in `equilibrium`.
        errors: likewise.
        contact: likewise.
        carrier: likewise.
        sun: likewise.

    Raises:
        ValueError: see `equilibrium`.
    """
    expect(design, "loaded", *KINDS)
    for name, value, known in (
        ("contact", contact, laws.CONTACTS),
        ("carrier", carrier, SUPPORTS),
        ("sun", sun, SUPPORTS),
    ):
        choose(name, value, known)
    for name in ("stiffness", "contact"):
        if getattr(design, name) is None:
            raise ValueError(f"{type(design).__name__}.{name} = None: the loaded equilibrium needs it")
    check_teeth(design.cycloid)
    check_kind(design, errors)
    return kind_of(design).layout(design, errors, contact, carrier, sun)


def admit(layout: Layout, design: Design, errors: Errors, torque: Scalar, angle: Scalar) -> Read:
    """Check the numbers that are read.

    Args:
        layout: counts and methods.
        design: the reducer.
        errors: of its parts.
        torque: () N m.
        angle: () rad.
    """
    return kind_of(design).admit(layout, design, errors, torque, angle)


def prepare(layout: Layout, read: Read, input_angle: jax.Array) -> Case:
    """Geometry, springs and gaps of one input angle; `load` is that of 1 N m.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        input_angle: () rad.
    """
    return kind_of(read.design).prepare(layout, read, input_angle)


def named_forces(layout: Layout, read: Read, case: Case, forces: Forces) -> NamedForces:
    """The forces by their names in the results.

    Args:
        layout: counts and methods.
        read: finite and possible numbers.
        case: of the angle.
        forces: of all contacts.
    """
    return kind_of(read.design).named_forces(layout, read, case, forces)
