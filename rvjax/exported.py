"""Traced programs, which the command line keeps for its next run: tracing takes longer than loading compiled code.

A program is found by its function, the structure and types of its arguments, the source of rvjax, the versions of
JAX and the settings of JAX. A file that does not load is traced and written again.
"""

import contextlib
import functools
import hashlib
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.export
import jax.numpy as jnp
import jaxlib.version
import numpy as np

from rvjax.files import write_atomically

SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_numpy_dtype_promotion")
SUFFIX = ".traced"


def exported(
    folder: Path, function: Callable[..., Any], static: Mapping[str, Any], arguments: tuple[Any, ...]
) -> tuple[Callable[..., Any], Callable[[Any], Any]] | None:
    """The function of flat arrays that a traced program computes, and what puts its results together again.

    Args:
        folder: of kept programs.
        function: of arrays, records and dicts of them.
        static: its arguments by keyword.
        arguments: the others, of which only structure and types count.

    Returns:
        None if an argument has no name that another process would understand: a function, a random key.
    """
    leaves, tree = jax.tree.flatten(arguments)
    types = [jax.typeof(leaf) for leaf in leaves]
    key = repr((function.__module__, function.__qualname__, sorted(static.items()), tree, types, _setting()))
    if " at 0x" in key or any(jnp.issubdtype(t.dtype, jax.dtypes.extended) for t in types):
        return None
    path = folder / f"{function.__name__}-{hashlib.sha256(key.encode()).hexdigest()[:32]}{SUFFIX}"
    try:
        shape, blob = pickle.loads(path.read_bytes())
        return jax.export.deserialize(blob).call, functools.partial(_put_together, shape)
    except FileNotFoundError:
        pass
    except Exception:  # whatever is wrong with the file: it is written again
        path.unlink(missing_ok=True)

    def flat(*leaves: Any) -> list[Any]:
        found, shape = jax.tree.flatten(function(*jax.tree.unflatten(tree, leaves), **static))
        flat.tree = shape  # type: ignore[attr-defined]
        return found

    given = [
        jax.ShapeDtypeStruct(t.shape, t.dtype, weak_type=t.weak_type, sharding=_spread(leaf))
        for t, leaf in zip(types, leaves)
    ]
    program = jax.export.export(jax.jit(flat))(*given)
    results: Any = flat.tree  # type: ignore[attr-defined]
    shape = jax.tree.unflatten(results, range(results.num_leaves))
    with contextlib.suppress(OSError):  # a full disk: traced again next time
        write_atomically(path, pickle.dumps((shape, program.serialize())))
    return program.call, functools.partial(_put_together, shape)


def plain(leaves: list[Any]) -> list[Any]:
    """Python numbers as arrays: a kept program has no weak types."""
    return [leaf if isinstance(leaf, jax.Array) else np.asarray(leaf, jax.typeof(leaf).dtype) for leaf in leaves]


def _put_together(shape: object, leaves: list[Any]) -> Any:
    return jax.tree.map(lambda number: leaves[number], shape)


def _spread(leaf: object) -> Any:
    """Sharding of an array over several devices."""
    sharding = getattr(leaf, "sharding", None)
    return sharding if sharding is not None and sharding.num_devices > 1 else None


def _setting() -> tuple[Any, ...]:
    own = [jax.config.values[name] for name in SETTINGS]
    return (
        *own,
        jax.__version__,
        jaxlib.version.__version__,
        jax.default_backend(),
        jax.local_device_count(),
        _source(),
    )


@functools.cache
def _source() -> str:
    """Digest of the source of rvjax."""
    folder = Path(__file__).parent
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return digest.hexdigest()
