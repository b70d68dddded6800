"""Symmetry of equally spaced cranks and discs: the model separates into small systems.

In the coordinates sum_i e^{i k psi_i} q_i / sqrt(M) of the planets and cranks, and likewise of the discs, only
few labels k couple with the central parts:

    rotational      k = 0 and the rotations of sun and output               11 coordinates, real
    translational   k = +1 and their translations x + i y                   11, Hermitian; k = -1 is its conjugate
    planetary       k = 2 .. M - 2, cranks and planets only                 6, real, M - 3 copies
    disc            k = 2 .. N - 2, discs only                              3, real, N - 3 copies

For M = 2 or N = 2 the labels +1 and -1 coincide on one side, and the two translational systems join into one
real system; with one disc, or members given one by one, nothing splits off and the whole model is one "coupled"
system.
"""

from functools import lru_cache

import jax
import numpy as np

from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import (
    Lumped,
    deflections,
    first_index,
    lump,
    mass_vector,
    spring_stiffness,
    spring_table,
    waves,
)
from rvjax.records import Array, Record, count, field, promote, record

WHOLE = -1
KINDS = ("rotational", "translational", "planetary", "disc", "coupled")


@record
class Block(Record):
    """One symmetry-reduced system."""

    mass: Array = field("kg, kg m2", "diagonal of its mass matrix", shape=("r",))
    stiffness: Array = field("N/m, N, N m", "its stiffness matrix, symmetric or Hermitian", shape=("r", "r"))
    copies: int = count("how often its spectrum occurs in the whole")


@record
class Blocks(Record):
    """Separate systems of M, N >= 3 cranks and discs."""

    rotational: Block = field("-", "central parts rotate, members alike", kind="record")
    translational: Block = field("-", "central parts translate; one of two conjugate systems", kind="record")
    planetary: Block | None = field("-", "planets and cranks alone; None for M = 3", kind="record", default=None)
    disc: Block | None = field("-", "discs alone; None for N = 3", kind="record", default=None)


@lru_cache
def sector(cranks: int, discs: int, kind: str, label: int = 0) -> np.ndarray:
    """Basis (n, r) of a subspace that the mean system maps into itself; a constant of a layout.

    Its columns are orthonormal; where it is complex, the conjugate basis spans another copy. `label` k chooses the copy
    of a planetary or disc sector; the label WHOLE selects all copies of a kind together, on a real basis.
    """
    if label == WHOLE:
        return _real_basis(cranks, discs, kind)
    start = first_index(cranks, discs)
    size = start["output"] + 3
    columns: list[np.ndarray] = []

    def central(part: str, *entries: complex) -> None:
        column = np.zeros(size, complex)
        column[start[part] : start[part] + 3] = entries
        columns.append(column)

    def members(part: str, wave: np.ndarray) -> None:
        wave = wave / np.linalg.norm(wave)
        for axis in range(3):
            column = np.zeros(size, complex)
            column[start[part] + axis : start[part] + 3 * len(wave) : 3] = wave
            columns.append(column)

    if kind == "coupled":
        return np.eye(size)
    if kind == "rotational":
        central("sun", 0, 0, 1)
        for part, number in (("planet", cranks), ("crank", cranks), ("disc", discs)):
            members(part, waves(number, 0))
        central("output", 0, 0, 1)
    elif kind == "translational" and is_split(cranks, discs):
        central("sun", np.sqrt(0.5), 1j * np.sqrt(0.5), 0)
        for part, number in (("planet", cranks), ("crank", cranks), ("disc", discs)):
            members(part, waves(number, 1))
        central("output", np.sqrt(0.5), 1j * np.sqrt(0.5), 0)
    elif kind == "translational":
        central("sun", 1, 0, 0)
        central("sun", 0, 1, 0)
        for part, number in (("planet", cranks), ("crank", cranks), ("disc", discs)):
            members(part, waves(number, 1).real)
            if number > 2:
                members(part, waves(number, 1).imag)
        central("output", 1, 0, 0)
        central("output", 0, 1, 0)
    else:
        number = cranks if kind == "planetary" else discs
        for part in ("planet", "crank") if kind == "planetary" else ("disc",):
            members(part, waves(number, label))
    basis = np.stack(columns, 1)
    return basis if np.abs(basis.imag).max() > 0 else basis.real


def is_split(cranks: int, discs: int) -> bool:
    """Return true where labels +1 and -1 are distinct for cranks and discs, so that conjugate sectors part."""
    return cranks >= 3 and discs >= 3


def is_symmetric(lumped: Lumped) -> bool:
    """Return true where central parts, or members alike, split off; one disc or unequal members couple everything."""
    return lumped.discs > 1 and lumped.alike


def kinds(lumped: Lumped) -> tuple[str, ...]:
    """Kinds of sectors that a reducer has; together they span the whole space."""
    if not is_symmetric(lumped):
        return ("coupled",)
    extra = (("planetary",) if lumped.cranks > 3 else ()) + (("disc",) if lumped.discs > 3 else ())
    return ("rotational", "translational", *extra)


def _real_basis(cranks: int, discs: int, kind: str) -> np.ndarray:
    number = {"planetary": cranks, "disc": discs}.get(kind)
    labels = [0] if number is None else range(2, number // 2 + 1)
    rows: list[np.ndarray] = []
    for label in labels:
        basis = sector(cranks, discs, kind, label)
        rows += [basis.real * 2**0.5, basis.imag * 2**0.5] if np.iscomplexobj(basis) else [basis]
    return np.concatenate(rows, axis=1)


@lru_cache
def sector_rows(cranks: int, discs: int, kind: str, label: int = 0) -> np.ndarray:
    """Deflection table of a sector (13, springs, r): `spring_table` rows times the basis."""
    return spring_table(cranks, discs).rows @ sector(cranks, discs, kind, label)


def sector_mass(lumped: Lumped, kind: str, label: int = 0) -> jax.Array:
    """Mass of a sector's coordinates (r,): that of the parts they move."""
    basis = sector(lumped.cranks, lumped.discs, kind, label)
    return mass_vector(lumped)[np.argmax(np.abs(basis), axis=0)]


def sector_stiffness(lumped: Lumped, kind: str, label: int = 0) -> jax.Array:
    """Stiffness matrix of a sector, sum k v* v^T; real where the symmetry makes it real."""
    rows = deflections(lumped, sector_rows(lumped.cranks, lumped.discs, kind, label))
    matrix = rows.conj().T @ (spring_stiffness(lumped).astype(rows.dtype)[:, None] * rows)
    return matrix if kind == "translational" else matrix.real


def blocks(design: RVReducer | Lumped) -> Blocks:
    """Return the symmetry-reduced systems of a reducer with three or more cranks and discs.

    Args:
        design: a reducer with inertia and stiffness, or its lumped parameters.

    Returns:
        Blocks; their spectra, each taken `copies` times, are the spectrum of the whole: 11 + 2 x 11 + 6 (M - 3) +
        3 (N - 3) frequencies.

    Raises:
        ValueError: fewer than three cranks or discs, members given one by one, or as `lump`.
    """
    lumped = lump(design)
    cranks, discs = lumped.cranks, lumped.discs
    if not is_split(cranks, discs):
        raise ValueError(f"blocks need three or more cranks and discs, got {cranks} cranks and {discs} discs")
    if not lumped.alike:
        raise ValueError("blocks need one number in each field of Inertia and Stiffness, not an array")
    return _blocks(lumped)


@jax.jit
def _blocks(lumped: Lumped) -> Blocks:
    lumped = promote(lumped)

    def block(kind: str, copies: int) -> Block | None:
        if copies == 0:
            return None
        label = 2 if kind in ("planetary", "disc") else 0
        return Block(sector_mass(lumped, kind, label), sector_stiffness(lumped, kind, label), copies)

    return Blocks(
        rotational=Block(sector_mass(lumped, "rotational"), sector_stiffness(lumped, "rotational"), 1),
        translational=Block(sector_mass(lumped, "translational"), sector_stiffness(lumped, "translational"), 2),
        planetary=block("planetary", lumped.cranks - 3),
        disc=block("disc", lumped.discs - 3),
    )
