"""Deprecated name of a private module, for one version: options of the compiler and the folder of kept programs."""

import warnings

from rvjax._jax.programs import QUICK, keep, prune, quick

warnings.warn(
    "rvjax.compile_cache is deprecated: give `jax.jit` its compiler options; the command line keeps programs by itself",
    DeprecationWarning,
    stacklevel=2,
)

__all__ = ["QUICK", "keep", "prune", "quick"]
