"""Modes of the lumped model: natural frequencies, shapes and kinds, and sectors in modal coordinates.

At the design at hand the eigenvectors make the dynamic stiffness of a sector diagonal, so that its solve is a
division: a whole frequency sweep for one eigenproblem. As a basis they are held fixed: the derivative is that of the
linear solve, whose matrix is no longer diagonal once the design moves. So nothing is differentiated through an
eigenvector, and repeated eigenvalues do no harm.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.catalogue import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import Lumped, admitted, deflections, loaded, lump, spring_stiffness
from rvjax.dynamics.symmetry import KINDS, WHOLE, kinds, sector, sector_mass, sector_rows, sector_stiffness
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, at_once

Key = tuple[str, int]  # kind of sector and label
REFINEMENTS = {"float32": 2, "float64": 0}  # steps that bring a single precision solve back to its rounding error


class ModalSector(NamedTuple):
    """One sector in mass-normalised coordinates on fixed eigenvectors."""

    basis: np.ndarray  # (n, r)
    transform: jax.Array  # (r, r): sector coordinates of each mode
    springs: jax.Array  # (springs, r): deflection of each spring in each mode
    stiffness: jax.Array  # (r, r): diagonal in value, not in its derivatives
    square: jax.Array  # (r,): angular frequencies squared

    def rows(self, indices: Sequence[int] | np.ndarray) -> jax.Array:
        """Physical coordinates in modal ones (k, r)."""
        return jnp.asarray(self.basis[indices], self.transform.dtype) @ self.transform


def modal_sectors(lumped: Lumped, keys: Sequence[Key]) -> dict[Key, ModalSector]:
    """Return the sectors of `keys` with their eigenvectors, all from one batched eigenproblem."""
    if not keys:  # no excited sector moves the required outputs
        return {}
    kinds = list(dict.fromkeys(kind for kind, _ in keys))
    first = [next(key for key in keys if key[0] == kind) for kind in kinds]
    scaled = []
    for key in first:
        inverse_root = jax.lax.rsqrt(sector_mass(lumped, *key))
        matrix = sector_stiffness(lumped, *key)
        scaled.append(matrix * (inverse_root[:, None] * inverse_root[None, :]).astype(matrix.dtype))
    _, vectors = jnp.linalg.eigh(jax.lax.stop_gradient(stacked(scaled)))
    own = {kind: vectors[i, : len(matrix), : len(matrix)] for i, (kind, matrix) in enumerate(zip(kinds, scaled))}
    k = spring_stiffness(lumped)
    sectors = {}
    for kind, label in keys:  # copies of one kind share their matrix, hence their eigenvectors
        rows = deflections(lumped, sector_rows(lumped.cranks, lumped.discs, kind, label))
        inverse_root = jax.lax.rsqrt(sector_mass(lumped, kind, label))
        dtype = np.result_type(rows.dtype, vectors.dtype)
        transform = inverse_root.astype(dtype)[:, None] * own[kind].astype(dtype)
        springs = rows.astype(dtype) @ transform
        stiffness = springs.conj().T @ (k.astype(dtype)[:, None] * springs)
        # A sum of squares: low frequencies keep their relative accuracy, which eigenvalues do not.
        square = jax.lax.stop_gradient(jnp.sum(k[:, None] * jnp.abs(springs) ** 2, axis=0))
        basis = sector(lumped.cranks, lumped.discs, kind, label)
        sectors[kind, label] = ModalSector(basis, transform, springs, stiffness, square)
    return sectors


def stacked(matrices: Sequence[jax.Array]) -> jax.Array:
    """Hermitian matrices of several sizes as one batch; what pads a smaller one lies beyond its spectrum."""
    largest = max(len(matrix) for matrix in matrices)
    dtype = np.result_type(*[matrix.dtype for matrix in matrices])
    padded = []
    for matrix in matrices:
        above = 1.01 * jax.lax.stop_gradient(jnp.max(jnp.sum(jnp.abs(matrix), axis=1)))
        filler = above.astype(dtype) * jnp.eye(largest - len(matrix), dtype=dtype)
        padded.append(jax.scipy.linalg.block_diag(matrix.astype(dtype), filler))
    return jnp.stack(padded)


class DynamicStiffness(NamedTuple):
    """Z = stiffness * A + root * A^(1/2) + scalar for a row of angular frequencies (L,), A the modal stiffness."""

    stiffness: jax.Array
    root: jax.Array
    scalar: jax.Array


def dynamic_stiffness(lumped: Lumped, frequency: jax.Array) -> DynamicStiffness:
    """Coefficients at signed angular frequencies (L,), none of them zero harmonics."""
    damping = lumped.damping
    sign = jnp.where(frequency < 0, -1, 1).astype(frequency.dtype)
    complex_ = jax.lax.complex
    return DynamicStiffness(
        complex_(jnp.ones_like(frequency), damping.loss_factor * sign + damping.rayleigh_stiffness * frequency),
        complex_(jnp.zeros_like(frequency), 2 * damping.modal_ratio * frequency),
        complex_(-(frequency**2), damping.rayleigh_mass * frequency),
    )


def modal_solve(modal: ModalSector, z: DynamicStiffness, rhs: jax.Array) -> jax.Array:
    """Z^-1 rhs in modal coordinates, rhs (L, r, m)."""
    dtype = rhs.dtype
    inverse = _inverse(modal, z)[:, :, None]
    matrix, root = modal.stiffness.astype(dtype), matrix_root(modal.stiffness, modal.square).astype(dtype)

    def multiply(x: jax.Array) -> jax.Array:
        stiff, rooted = jnp.einsum("ij,ljm->lim", matrix, x), jnp.einsum("ij,ljm->lim", root, x)
        return z.stiffness[:, None, None] * stiff + z.root[:, None, None] * rooted + z.scalar[:, None, None] * x

    def divide(multiplied: PyTree, b: jax.Array) -> jax.Array:
        x = b * inverse
        for _ in range(REFINEMENTS[str(modal.square.dtype)]):
            x = x + (b - multiplied(x)) * inverse
        return x

    return jax.lax.custom_linear_solve(multiply, rhs, divide, divide)


def on_resonance(modal: ModalSector, z: DynamicStiffness) -> jax.Array:
    """Return true where an undamped frequency meets a mode to rounding."""
    value, size = _diagonal(modal, z)
    return jnp.any(jnp.abs(value.real) + jnp.abs(value.imag) <= _floor(size))


def residual(modal: ModalSector, z: DynamicStiffness, solution: jax.Array, rhs: jax.Array) -> jax.Array:
    """Largest |Z x - b| / (|Z| |x| + |b|) over the frequencies."""
    dtype = rhs.dtype
    root, one = jnp.diag(jnp.sqrt(modal.square)), jnp.eye(len(modal.square))
    terms = [term.astype(dtype) for term in (modal.stiffness, root, one)]
    matrix = sum(c[:, None, None] * term[None] for c, term in zip(z, terms))
    miss = jnp.linalg.norm(jnp.einsum("lij,ljm->lim", matrix, solution) - rhs, axis=(1, 2))
    size = jnp.linalg.norm(matrix, axis=(1, 2)) * jnp.linalg.norm(solution, axis=(1, 2))
    size = size + jnp.linalg.norm(rhs, axis=(1, 2))
    return jax.lax.stop_gradient(jnp.max(miss / jnp.where(size > 0, size, 1)))


def _floor(size: jax.Array) -> jax.Array:
    return 4 * jnp.finfo(size.dtype).eps * size


def _diagonal(modal: ModalSector, z: DynamicStiffness) -> tuple[jax.Array, jax.Array]:
    """Value of Z in modal coordinates (L, r), no derivative, and the size of its terms."""
    stiffness, root, scalar = jax.tree.map(lambda c: jax.lax.stop_gradient(c)[:, None], z)
    square = modal.square[None, :]
    value = stiffness * square.astype(scalar.dtype) + root * jnp.sqrt(square).astype(scalar.dtype) + scalar
    return value, square + jnp.abs(scalar)


def _inverse(modal: ModalSector, z: DynamicStiffness) -> jax.Array:
    """One over the diagonal, kept from zero so that a resonance gives a large number, not NaN."""
    value, size = _diagonal(modal, z)
    floor = _floor(jnp.maximum(size, jnp.finfo(size.dtype).eps * jnp.max(modal.square)))
    small = jnp.abs(value.real) + jnp.abs(value.imag) <= floor
    real, imaginary = jnp.where(small, floor, value.real), jnp.where(small, 0, value.imag)
    square = real**2 + imaginary**2  # XLA divides complex numbers one by one; this runs in vectors
    return jax.lax.complex(real / square, -imaginary / square)


@jax.custom_jvp
def matrix_root(matrix: jax.Array, square: jax.Array) -> jax.Array:
    """Square root of a positive semidefinite matrix whose value is diag(square)."""
    return jnp.diag(jnp.sqrt(square)).astype(matrix.dtype)


@matrix_root.defjvp
def _matrix_root_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[jax.Array, jax.Array]:
    matrix, square = primals
    root = matrix_root(matrix, square)
    pair = jnp.sqrt(square)[:, None] + jnp.sqrt(square)[None, :]
    pair = jnp.where(pair > 0, pair, 1).astype(matrix.dtype)

    def divide(_: object, b: jax.Array) -> jax.Array:
        return b / pair

    # S S = A gives S dS + dS S = dA.
    return root, jax.lax.custom_linear_solve(lambda x: root @ x + x @ root, tangents[0], divide, divide)


@record
class Modes(Record):
    """Undamped modes of the mean system, ascending."""

    frequency: Array = field("Hz", "natural frequencies; rigid motions have exactly 0", shape=("modes",))
    shape: Array = field("1/sqrt(kg)", "columns: mass-normalised shapes, rows as System.labels", shape=("n", "modes"))
    kind_index: Array = field("-", "kind of each mode, an index into KINDS", shape=("modes",), kind="integer")
    info: SolveInfo = field("-", "CONVERGED, INVALID_GEOMETRY or NONFINITE", kind="record")

    @property
    def kind(self) -> np.ndarray:
        """Kind of each mode as text: rotational, translational, planetary, disc or coupled (outside jit)."""
        return np.array(KINDS)[np.asarray(self.kind_index)]


@checked
def modes(design: RVReducer | Lumped, *, load_inertia: Scalar = 0.0) -> Modes:
    """Natural frequencies and mode shapes of the mean system (Eq. 2), by kind.

    With three or more cranks and discs modes are rotational, translational (in pairs), planetary (planets and
    cranks alone) or disc. With two of either the translational pairs split and mix; with one disc, or members given
    one by one, all modes are "coupled". Derivatives hold at repeated frequencies too, for every change that members
    share, since that keeps the symmetry; shapes of a pair are any two of its plane. One member alone splits the
    pairs of equal members, which has no derivative: there the sum over a pair is right.

    Args:
        design: a reducer with inertia and stiffness, or its lumped parameters.
        load_inertia: of what the output drives, () kg m2.

    Returns:
        Modes; NaN for INVALID_GEOMETRY (radii or masses not positive) and NONFINITE input.

    Raises:
        ValueError: as `rvjax.dynamics.lump`.
    """
    return _modes(lump(design), load_inertia)


@jax.jit
def _modes(lumped: Lumped, load_inertia: Array) -> Modes:
    lumped, _, gate = admitted(loaded(lumped, load_inertia))
    keys = [(kind, WHOLE) for kind in kinds(lumped)]
    scaled, roots = [], []
    for key in keys:
        roots.append(jax.lax.rsqrt(sector_mass(lumped, *key)))
        scaled.append(sector_stiffness(lumped, *key) * roots[-1][:, None] * roots[-1][None, :])
    squares, shapes, codes = [], [], []
    k = spring_stiffness(lumped)
    _, vectors = _eigh(stacked(scaled))
    for i, (key, root) in enumerate(zip(keys, roots)):
        own = root[:, None] * vectors[i, : len(root), : len(root)]
        springs = deflections(lumped, sector_rows(lumped.cranks, lumped.discs, *key)) @ own
        squares.append(jnp.sum(k[:, None] * springs**2, axis=0))  # a sum of squares keeps small ones accurate
        shapes.append(jnp.asarray(sector(lumped.cranks, lumped.discs, *key), own.dtype) @ own)
        codes += [KINDS.index(key[0])] * len(root)
    square, shape = jnp.concatenate(squares), jnp.concatenate(shapes, axis=1)
    order = jnp.argsort(square)
    square, shape = square[order], shape[:, order]
    rigid = square <= jnp.finfo(square.dtype).eps * jnp.max(square)
    frequency = jnp.where(rigid, 0, jnp.sqrt(jnp.where(rigid, 1, square)) / (2 * jnp.pi))
    overflow = (~jnp.all(jnp.isfinite(frequency)), Status.NONFINITE)
    (frequency, shape), info = gate.close((frequency, shape), overflow, info=at_once(square[0]))
    return Modes(frequency, shape, kind_index=jnp.asarray(codes, jnp.int32)[order], info=info)


Pair = tuple[jax.Array, jax.Array]


@jax.custom_jvp
def _eigh(matrix: jax.Array) -> tuple[jax.Array, jax.Array]:
    values, vectors = jnp.linalg.eigh(matrix)[:2]
    return values, vectors


@_eigh.defjvp
def _eigh_jvp(primals: tuple[jax.Array, ...], tangents: tuple[jax.Array, ...]) -> tuple[Pair, Pair]:
    # A change of the design keeps the symmetry, hence every repeated pair: inside a pair nothing turns.
    values, vectors = _eigh(primals[0])
    change = jnp.swapaxes(vectors, -1, -2) @ tangents[0] @ vectors
    gap = values[..., None, :] - values[..., :, None]
    floor = 100 * jnp.finfo(values.dtype).eps * jnp.max(jnp.abs(values), axis=-1)[..., None, None]
    apart = jnp.abs(gap) > floor
    turn = jnp.where(apart, change / jnp.where(apart, gap, 1), 0)
    return (values, vectors), (jnp.diagonal(change, axis1=-2, axis2=-1), vectors @ turn)
