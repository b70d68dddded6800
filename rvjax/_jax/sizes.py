"""Sizes of blocks and calls, and rows filled up to such a size.

A block is what a loop of a program computes together, a call what the host gives to a program together. Both depend on
the platform: the arrays of a block fit the cache of a core, and a GPU computes 17,000 cases at once. The size of a
block is read where a program is lowered, that of a call where its arrays are placed. A process with a GPU may compute
on its processor, so neither follows the default of the process: `lowering` is a context that is part of the key under
which JAX keeps what it traced. Gain: a loaded unit of 24 angles takes 3.3 instead of 342 us on a GPU.
"""

import sys
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

Rows = TypeVar("Rows", np.ndarray, jax.Array)

CPU = "cpu"
GPU = "gpu"
"""Any platform but a processor."""

_lowered_for = jax.make_user_context(CPU)  # part of the key under which JAX keeps what it traced


def lowering(platform: str) -> AbstractContextManager[None]:
    """A context within which what is traced is lowered for `platform`, a name of JAX such as "cpu" or "cuda"."""
    context: AbstractContextManager[None] = _lowered_for(CPU if platform == CPU else GPU)
    return context


def for_processor() -> bool:
    """True where a program is traced for a processor, and outside of `lowering`."""
    return bool(_lowered_for.value == CPU)


def default_platform() -> str:
    """Platform of what is on no device yet: of `jax.default_device`, else of the first device."""
    config: Any = jax.config  # its `values` would make a dict of all options
    device = config.jax_default_device
    if device is None:
        return jax.local_devices()[0].platform
    return device if isinstance(device, str) else device.platform


def platform_of(arguments: object) -> str:
    """Platform of a program of these arguments: of the first array that was put on a device, else the default."""
    for leaf in jax.tree.leaves(arguments):
        if isinstance(leaf, jax.Array) and not isinstance(leaf, jax.core.Tracer) and leaf.committed:
            return next(iter(leaf.devices())).platform
    return default_platform()


def spread(leaf: object) -> jax.sharding.Sharding | None:
    """Sharding of an array over several devices; None for any other leaf."""
    sharding = getattr(leaf, "sharding", None)
    return sharding if sharding is not None and sharding.num_devices > 1 else None


class Size(NamedTuple):
    """Rows of a block or a call, on a processor and on a GPU."""

    cpu: int
    gpu: int

    def on(self, platform: str) -> int:
        """The size on a platform of JAX."""
        return self.cpu if platform == CPU else self.gpu

    @property
    def here(self) -> int:
        """The size in the program that is being lowered."""
        return self.cpu if for_processor() else self.gpu


ALL = sys.maxsize
"""All rows in one block."""

# Blocks within a program.
EQUILIBRIA = Size(64, ALL)
"""Equilibria of the loaded reducer. A unit of 24 angles takes 3.3 us on an H100; 342 us in blocks of 64."""
ROLLER_CASES = Size(192, ALL)
"""Cases of roller forces, 26 x 192 numbers; a case takes 0.54 us, with 512 0.78: rows that are a page apart share
places of the cache. A case takes 0.6 us on an H100; 19 us in blocks of 512."""
LINES = 2**15
"""Numbers of the lines of vibration of a block of units, a quarter of a megabyte: the second cache of a core."""
LEFT_OPEN = 256
"""Cases of roller forces that Newton steps left open, solved together."""
LOADS = 8
"""Loads of a bearing whose points are computed together: what they need stays in the cache."""
REPAIRED = 32
"""Neighbouring batch elements that are computed again together: a crank turn takes 57 ns, 63 ns with 128."""
GROUP = 8
"""Equilibria that share a geometry; with fewer each has its own."""

# Calls of a program by the host.
SOLVED = Size(256, 4096)
"""Costly units that are solved together. A unit takes 7.8 us on an H100, 3.3 us in calls of 32,768."""
SLOPED = Size(256, 2048)
"""Units whose gradients are formed together: few, because a reverse pass keeps all intermediate values of a unit."""

# Units that a method takes together on every platform, so that its result is the same on all.
CHUNK = 32_768
"""Units of a chunk of Monte Carlo: the temporaries of a revolution of 64 angles stay near the cache."""
BLOCK = 4096
"""Default number of units at once: the same everywhere, so that a response is compiled for it once; temporaries of
a response over many angles then fit the cache. A four-bar unit takes no longer than in blocks of 16,384."""
AT_ONCE = 256
"""Costly units of a sample."""
PLOTTED = 64
"""Units with plotted curves: 24 take 0.36 s, and 1.35 s in a call of 256. A program of 32 takes 0.19 s, but compiles in
twice the time."""
PULLED = 256
"""Units behind one gradient of a method."""
CORNERS = 64
"""Points of a worst case."""
TESTED, SEARCHES = 1024, 32
"""Units of a failure probability without gradients, and searches of design points."""
LINEARISED, DENSITIES = 8, 64
"""Units of an identification, or parts of them, with slopes; and where only the density is required."""
PRIORS = 8, 4096
"""Few or many parameters of a prior."""
ASSEMBLED = 64, 4096
"""Few or many units of an assembly, so that a response is compiled twice at most."""
COMBINATIONS = 2**18
"""Combinations of parts whose costs are estimated."""
SETS = 256
"""Sets of measurements whose gain is computed."""
CURVES = 256
"""Draws whose curves of a correction are small."""
PUBLISHED = 200
"""Cases of a published table, so that all its figures share one program."""


def padded(rows: Rows, size: int, *, axis: int = 0, fill: float | None = None) -> Rows:
    """Rows up to a multiple of `size`, so that one program serves any number of them.

    Args:
        rows: an array; or numbers of rows, where several arrays are filled up alike.
        size: of a block or a call.
        axis: of the rows.
        fill: number in the rows that are added; None: the last row again.
    """
    width = [(0, 0)] * rows.ndim
    width[axis] = 0, -rows.shape[axis] % size
    if width[axis] == (0, 0):
        return rows
    pad: Any = np.pad if isinstance(rows, np.ndarray) else jnp.pad
    return pad(rows, width, mode="edge") if fill is None else pad(rows, width, constant_values=fill)


def calls(count: int, size: int) -> np.ndarray:
    """Numbers of `count` rows (calls, size), the last one again where a call is not full."""
    return padded(np.arange(count), size).reshape(-1, size)
