"""Traced programs, which the command line keeps for its next run: tracing takes longer than loading compiled code.

A program is found by its function, the structure and types of its arguments, the source of rvjax, the versions of
JAX and the settings of JAX. Its file is that of `jax.export`, with the structure of its results. A file that does not
load is traced and written again. Gain: the first values of 1,024 units of `rv-40e-whole` take 1.9 instead of 24 CPU s
in a second run, the gradients of 256 units 1.4 instead of 34.
"""

import contextlib
import dataclasses
import functools
import hashlib
import pickle
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import jax
import jax.export
import jax.numpy as jnp
import jaxlib.version
import numpy as np

from rvjax._jax.sizes import platform_of, spread
from rvjax.base.files import write_atomically
from rvjax.records import Array, PyTree, Scalar

SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_numpy_dtype_promotion")
R = TypeVar("R")
SUFFIX = ".traced"


def exported(
    folder: Path,
    function: Callable[..., R],
    static: Mapping[str, object],
    arguments: tuple[object, ...],
    options: dict[str, bool | int] | None = None,
) -> Callable[[list[Scalar]], R] | None:
    """The traced program of a function, of the leaves of its arguments.

    Args:
        folder: of kept programs.
        function: of arrays, records and dicts of them.
        static: its arguments by keyword.
        arguments: the others, of which only structure and types count.
        options: of the compiler.

    Returns:
        None if an argument has no name that another process would understand: a function, a random key.
    """
    leaves, tree = jax.tree.flatten(arguments)
    platform = platform_of(leaves)
    types = _types(leaves)
    if any(jnp.issubdtype(t.dtype, jax.dtypes.extended) for t in types):
        return None
    try:
        about = function.__module__, function.__qualname__, sorted(static.items()), tree, types
        key = _spelled((*about, *_setting(platform)))
    except _Unnamed:
        return None
    path = folder / f"{function.__name__}-{hashlib.sha256(key.encode()).hexdigest()[:32]}{SUFFIX}"
    try:
        shape, blob = pickle.loads(path.read_bytes())
        _linear_algebra()
        return _of_leaves(jax.export.deserialize(blob), shape, options)
    except FileNotFoundError:
        pass
    except Exception:  # a file with any defect is written again
        path.unlink(missing_ok=True)

    def flat(*leaves: Array) -> list[Array]:
        found, shape = jax.tree.flatten(function(*jax.tree.unflatten(tree, leaves), **static))
        flat.tree = shape  # type: ignore[attr-defined]
        return found

    shapes = [
        jax.ShapeDtypeStruct(t.shape, t.dtype, weak_type=t.weak_type, sharding=spread(leaf))
        for t, leaf in zip(types, leaves)
    ]
    program = jax.export.export(jax.jit(flat), platforms=[_lowered_for(platform)])(*shapes)
    results: Any = flat.tree  # type: ignore[attr-defined]
    shape = jax.tree.unflatten(results, range(results.num_leaves))
    with contextlib.suppress(OSError):  # a full disk: traced again next time
        write_atomically(path, pickle.dumps((shape, program.serialize())))
    return _of_leaves(program, shape, options)


def _types(leaves: list[Scalar]) -> list[jax.core.ShapedArray]:
    """Types of leaves: a number of a study and one of a stored result have one type, where all are float64."""
    types, default = [jax.typeof(leaf) for leaf in leaves], jnp.result_type(float)
    if any(t.dtype != default for t in types if jnp.issubdtype(t.dtype, jnp.inexact)):
        return types  # a Python number takes the precision of an array that it meets
    return [t.update(weak_type=False) if t.dtype == default else t for t in types]


def _of_leaves(
    program: jax.export.Exported, shape: object, options: dict[str, bool | int] | None
) -> Callable[[list[Scalar]], Any]:
    """The program as a function of the leaves of its arguments; it has no weak types.

    Where several devices share the units, most numbers are those of the call before: they stay on the devices. Copies
    of 125 numbers a call took 17 of 101 s of an allocation. One device takes numbers of the host as quickly. An array
    that may be written to is copied in each call.
    """
    call = jax.jit(program.call, compiler_options=options)
    placed: dict[int, tuple[Scalar, Any]] = {}  # by place: the number, and its array

    def of(leaves: list[Scalar]) -> Any:
        rows: Any = next((sharding for leaf in reversed(leaves) if (sharding := spread(leaf)) is not None), None)
        split = None if rows is None else jax.sharding.NamedSharding(rows.mesh, jax.sharding.PartitionSpec())
        arrays = list[Array]()
        for k, (leaf, t) in enumerate(zip(leaves, program.in_avals)):
            if isinstance(leaf, jax.Array):
                arrays.append(leaf)
                continue
            changes = isinstance(leaf, np.ndarray) and leaf.flags.writeable
            if changes or k not in placed or placed[k][0] is not leaf:
                number = np.asarray(leaf, t.dtype)
                placed[k] = leaf, number if split is None else jax.device_put(number, split)
            arrays.append(placed[k][1])
        found = call(*arrays)
        return jax.tree.map(lambda number: found[number], shape)

    return of


@functools.cache
def _linear_algebra() -> None:
    """Let JAX load LAPACK, which it does when it lowers such an operation; a program from a file would call nothing."""
    jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), jnp.float32))


class _Unnamed(Exception):
    """Another process would not find what this means."""


def _spelled(value: PyTree) -> str:
    """Text that means the same value in every process.

    Raises:
        _Unnamed: a function that is no attribute of a module, or an object that prints its address.
    """
    if isinstance(value, type(jax.tree.structure(0))):
        tree: Any = value  # its methods have no types
        data = tree.node_data()
        inside = () if data is None else (*data, *tree.children())
        return f"{tree.num_leaves}{_spelled(inside)}"
    if isinstance(value, functools.partial):
        return f"partial{_spelled((value.func, value.args, value.keywords))}"
    if isinstance(value, (tuple, list)):
        return f"{type(value).__name__}({', '.join(map(_spelled, value))})"
    if isinstance(value, dict):
        return f"dict({', '.join(f'{_spelled(key)}: {_spelled(item)}' for key, item in value.items())})"
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [(f.name, getattr(value, f.name)) for f in dataclasses.fields(value)]
        return f"{type(value).__module__}.{type(value).__qualname__}{_spelled(fields)}"
    if isinstance(value, jax.sharding.Mesh):  # its number of devices is that of the process, see `_setting`
        return f"Mesh{_spelled((value.axis_names, value.axis_sizes))}"
    if callable(value) and value is not type(None):
        name, found = getattr(value, "__qualname__", ""), sys.modules.get(getattr(value, "__module__", None) or "")
        for part in name.split("."):
            found = getattr(found, part, None)
        if found is value:
            return f"{value.__module__}.{name}"
        code = getattr(value, "__code__", None)  # a lambda of this package, whose source is part of the key
        if code is None or value.__closure__ or value.__defaults__ or not value.__module__.startswith("rvjax."):
            raise _Unnamed
        places = [place for place in code.co_positions() if place[2]]  # a line may have several lambdas
        if not places:
            raise _Unnamed
        return f"{value.__module__}.{name} at {places[0]}"
    if " at 0x" in (text := repr(value)):
        raise _Unnamed
    return text


def _lowered_for(platform: str) -> str:
    """Name of a platform in `jax.export`, which has two for "gpu"."""
    if platform != "gpu":
        return platform
    return "rocm" if "rocm" in jax.local_devices(backend=platform)[0].client.platform_version.lower() else "cuda"


def _setting(platform: str) -> tuple[object, ...]:
    own = [jax.config.values[name] for name in SETTINGS]
    return (
        *own,
        jax.__version__,
        jaxlib.version.__version__,
        platform,
        len(jax.local_devices(backend=platform)),
        _source(),
    )


@functools.cache
def _source() -> str:
    """Digest of the source of rvjax, all packages: any of them may be part of a program."""
    folder = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        digest.update(f"{path.relative_to(folder)}\0".encode() + path.read_bytes())
    return digest.hexdigest()
