"""Traced programs, which the command line keeps for its next run: tracing takes longer than loading compiled code.

A program is found by its function, the structure and types of its arguments, the source of rvjax, the versions of
JAX and the settings of JAX. A file that does not load is traced and written again.

The numbers of a response, about a hundred Python floats, reach the program as one array. One by one, JAX placed each of
them on each device at every call: 137,000 times in one result of the loaded study.
"""

import contextlib
import dataclasses
import functools
import hashlib
import io
import math
import pickle
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import jax
import jax.export
import jax.numpy as jnp
import jaxlib.version
import numpy as np
from jax.extend.mlir import ir, passmanager
from jax.interpreters import mlir

from rvjax._ground.files import write_atomically
from rvjax._jax.blocks import platform_of, spread
from rvjax.records import Array, PyTree, Scalar

SETTINGS = ("jax_enable_x64", "jax_default_matmul_precision", "jax_debug_nans", "jax_numpy_dtype_promotion")
R = TypeVar("R")
SUFFIX = ".traced"
_FEW = 64  # numbers of a leaf that travels with others


class Kept(NamedTuple):
    """A traced program."""

    call: Callable[..., list[Array]]  # of the arrays that `given` returns
    given: Callable[[list[Scalar]], list[Array | np.ndarray]]  # of the leaves of the arguments
    put_together: Callable[[list[Array]], Any]  # of the results


def exported(
    folder: Path, function: Callable[..., R], static: Mapping[str, object], arguments: tuple[PyTree, ...]
) -> Kept | None:
    """The traced program of a function.

    Args:
        folder: of kept programs.
        function: of arrays, records and dicts of them.
        static: its arguments by keyword.
        arguments: the others, of which only structure and types count.

    Returns:
        None if an argument has no name that another process would understand: a function, a random key.
    """
    leaves, tree = jax.tree.flatten(arguments)
    platform = platform_of(leaves)
    types = [jax.typeof(leaf) for leaf in leaves]
    if any(jnp.issubdtype(t.dtype, jax.dtypes.extended) for t in types):
        return None
    packed = _packed(leaves, types)  # travel as one array: a Python number there, read from a file an array of one
    types = [t.update(weak_type=False) if i in packed else t for i, t in enumerate(types)]
    rest = tuple(i for i in range(len(leaves)) if i not in packed)
    try:
        about = function.__module__, function.__qualname__, sorted(static.items()), tree, types, packed
        key = _spelled((*about, *_setting(platform)))
    except _Unnamed:
        return None
    path = folder / f"{function.__name__}-{hashlib.sha256(key.encode()).hexdigest()[:32]}{SUFFIX}"
    given = functools.partial(_given, packed, rest)
    try:
        shape, blob = pickle.loads(path.read_bytes())
        _linear_algebra()
        return Kept(_Binary.of(jax.export.deserialize(blob)).call, given, functools.partial(_put_together, shape))
    except FileNotFoundError:
        pass
    except Exception:  # a file with any defect is written again
        path.unlink(missing_ok=True)

    def flat(*arrays: Array) -> list[Array]:
        found, shape = jax.tree.flatten(function(*jax.tree.unflatten(tree, _unpacked(packed, types, arrays)), **static))
        flat.tree = shape  # type: ignore[attr-defined]
        return found

    shapes = [
        jax.ShapeDtypeStruct(t.shape, t.dtype, weak_type=t.weak_type, sharding=spread(leaf))
        for t, leaf in ((types[i], leaves[i]) for i in rest)
    ]
    if packed:
        count = sum(math.prod(types[i].shape) for i in packed)
        shapes.insert(0, jax.ShapeDtypeStruct((count,), jnp.result_type(float)))
    program = _Binary.of(_small(jax.export.export(jax.jit(flat), platforms=[_lowered_for(platform)])(*shapes)))
    results: Any = flat.tree  # type: ignore[attr-defined]
    shape = jax.tree.unflatten(results, range(results.num_leaves))
    with contextlib.suppress(OSError):  # a full disk: traced again next time
        write_atomically(path, pickle.dumps((shape, program.serialize())))
    return Kept(program.call, given, functools.partial(_put_together, shape))


class _Binary(jax.export.Exported):
    """A traced program that JAX reads as bytecode; a text, written and read again, takes three times as long."""

    @classmethod
    def of(cls, program: jax.export.Exported) -> "_Binary":
        """The program of `_small`, or one written by it."""
        return cls(**{f.name: getattr(program, f.name) for f in dataclasses.fields(program)})

    def mlir_module(self, serialized: bool = True) -> Any:
        """Bytecode of the module; later versions of JAX take the module itself, and print nothing."""
        return self.mlir_module_serialized if serialized else ir.Module.parse(self.mlir_module_serialized)  # type: ignore[attr-defined]


def _small(program: jax.export.Exported) -> jax.export.Exported:
    """A program as bytecode of this version of JAX, without lines of its source."""
    with mlir.make_ir_context():
        module, file = ir.Module.parse(program.mlir_module()), io.BytesIO()  # type: ignore[attr-defined]
        passmanager.PassManager.parse("builtin.module(strip-debuginfo)").run(module.operation)  # type: ignore[attr-defined]
        module.operation.write_bytecode(file=file)
    return dataclasses.replace(program, mlir_module_serialized=file.getvalue())


def _packed(leaves: list[Scalar], types: list[jax.core.ShapedArray]) -> tuple[int, ...]:
    """Leaves that travel in one array: few numbers each, not on a device, all of the default precision."""
    default = jnp.result_type(float)
    inexact = [t.dtype for t in types if jnp.issubdtype(t.dtype, jnp.inexact)]
    if any(dtype != default for dtype in inexact):  # a Python number takes the precision of an array that it meets
        return ()
    return tuple(
        i
        for i, (leaf, t) in enumerate(zip(leaves, types))
        if not isinstance(leaf, jax.Array) and t.dtype == default and math.prod(t.shape) <= _FEW
    )


def _given(packed: tuple[int, ...], rest: tuple[int, ...], leaves: list[Scalar]) -> list[Array | np.ndarray]:
    """Arrays of a call: the packed leaves, then the others; a kept program has no weak types."""
    others = [
        leaf if isinstance(leaf, jax.Array) else np.asarray(leaf, jax.typeof(leaf).dtype)
        for leaf in (leaves[i] for i in rest)
    ]
    if not packed:
        return others
    numbers: list[Scalar] = []
    for leaf in (leaves[i] for i in packed):  # a hundred Python numbers are an array in one step
        numbers += [leaf] if isinstance(leaf, float) else np.ravel(leaf).tolist()
    return [np.array(numbers, jnp.result_type(float)), *others]


def _unpacked(packed: tuple[int, ...], types: list[jax.core.ShapedArray], arrays: tuple[Array, ...]) -> list[Array]:
    """The leaves again."""
    others = iter(arrays[1:] if packed else arrays)
    found, start = [], 0
    for i, t in enumerate(types):
        if i not in packed:
            found.append(next(others))
            continue
        count = math.prod(t.shape)
        found.append(jax.lax.slice_in_dim(arrays[0], start, start + count).reshape(t.shape))
        start += count
    return found


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
        return _spelled((value.__module__, name, code.co_firstlineno, code.co_code, code.co_consts, code.co_names))
    if " at 0x" in (text := repr(value)):
        raise _Unnamed
    return text


def _put_together(shape: object, leaves: list[Array]) -> PyTree:
    return jax.tree.map(lambda number: leaves[number], shape)


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
