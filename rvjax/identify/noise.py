"""`Noise`: the random error of measured numbers."""

import dataclasses
import math

import jax
import numpy as np

from rvjax.records import PyTree


@dataclasses.dataclass(frozen=True, eq=False)
class Noise:
    """Random error of every measured real number; a complex number holds two, independent of each other.

    Attributes:
        sd: standard deviation (the scale of Student noise), unit of the observation: one number, or the structure of
            the observation with a number or an array in each place.
        dof: degrees of freedom of Student noise, for data with outliers; inf is normal noise.
    """

    sd: PyTree
    dof: float = dataclasses.field(default=math.inf, kw_only=True)

    def __post_init__(self) -> None:
        """Raise ValueError for a value that is no standard deviation."""
        leaves = jax.tree_util.tree_flatten_with_path(self.sd, is_leaf=lambda item: item is None)[0]
        if not leaves:
            raise ValueError(f"Noise.sd = {self.sd!r}: must hold a number, unit of the observation")
        for path, leaf in leaves:
            name = "Noise.sd" + jax.tree_util.keystr(path)
            try:
                sd = np.asarray(leaf, float)
            except (TypeError, ValueError):
                raise ValueError(f"{name} = {leaf!r}: must be a number, unit of the observation") from None
            bad = ~((sd > 0) & np.isfinite(sd))
            if bad.any():
                worst = float(sd[bad].flat[0])
                raise ValueError(f"{name} = {worst:.6g}: must be positive and finite, unit of the observation")
        if isinstance(self.dof, bool) or not isinstance(self.dof, (int, float)) or not self.dof > 0:
            raise ValueError(f"Noise.dof = {self.dof!r}: must be a positive number (inf: normal noise)")
