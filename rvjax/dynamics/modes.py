"""Natural frequencies, mode shapes and their kinds."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._reducer.plausible import checked
from rvjax.designs import RVReducer
from rvjax.dynamics.assembly import (
    Lumped,
    admitted,
    deflections,
    loaded,
    lump,
    spring_stiffness,
)
from rvjax.dynamics.modal import stacked
from rvjax.dynamics.symmetry import KINDS, WHOLE, kinds, sector, sector_mass, sector_rows, sector_stiffness
from rvjax.records import Array, PyTree, Record, Scalar, field, record
from rvjax.status import SolveInfo, Status, at_once


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
        shapes.append(jnp.asarray(sector(lumped.cranks, lumped.discs, *key).basis, own.dtype) @ own)
        codes += [KINDS.index(key[0])] * len(root)
    square, shape = jnp.concatenate(squares), jnp.concatenate(shapes, axis=1)
    order = jnp.argsort(square)
    square, shape = square[order], shape[:, order]
    rigid = square <= jnp.finfo(square.dtype).eps * jnp.max(square)
    frequency = jnp.where(rigid, 0, jnp.sqrt(jnp.where(rigid, 1, square)) / (2 * jnp.pi))
    overflow = (~jnp.all(jnp.isfinite(frequency)), Status.NONFINITE)
    (frequency, shape), info = gate.close((frequency, shape), overflow, info=at_once(square[0]))
    return Modes(frequency, shape, kind_index=jnp.asarray(codes, jnp.int32)[order], info=info)


@jax.custom_jvp
def _eigh(matrix: jax.Array) -> tuple[jax.Array, jax.Array]:
    values, vectors = jnp.linalg.eigh(matrix)[:2]
    return values, vectors


@_eigh.defjvp
def _eigh_jvp(primals: PyTree, tangents: PyTree) -> PyTree:
    # A change of the design keeps the symmetry, hence every repeated pair: inside a pair nothing turns.
    values, vectors = _eigh(primals[0])
    change = jnp.swapaxes(vectors, -1, -2) @ tangents[0] @ vectors
    gap = values[..., None, :] - values[..., :, None]
    floor = 100 * jnp.finfo(values.dtype).eps * jnp.max(jnp.abs(values), axis=-1)[..., None, None]
    apart = jnp.abs(gap) > floor
    turn = jnp.where(apart, change / jnp.where(apart, gap, 1), 0)
    return (values, vectors), (jnp.diagonal(change, axis1=-2, axis2=-1), vectors @ turn)
