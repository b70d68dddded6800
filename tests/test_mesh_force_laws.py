"""The power series of the line contact against the exact law, and the bound of what the series leaves."""

import jax.numpy as jnp
import numpy as np

from rvjax.mesh_force import laws


def test_the_stiffness_of_the_series_is_as_good_as_it_says():
    """Oracle: the exact law, whose approach at a load needs no series; tolerance: 32 roundings beside the bound."""
    rng = np.random.default_rng(5)
    count = 4000
    cage = 10 ** rng.uniform(-3, 1, count)
    roller = laws.Compliance(
        cage=cage,
        gear=np.sqrt(1 + cage**2),
        cam_radius=rng.uniform(0.5, 1, count),
        gear_radius=10 ** rng.uniform(-1, np.log10(5), count),
        palmgren=1.0,
    )
    load = laws.load_limit("hertz", roller) * 10 ** rng.uniform(-6, -1, count)
    _, rate = laws.series(laws.approach("hertz", load, roller), roller)
    small = 2 / roller.weight
    bend = jnp.abs(rate / small - 1)
    exact = 1 / laws.slope("hertz", load, roller)
    miss = np.asarray(jnp.abs(rate - exact) / exact)
    assert (miss <= laws.series_error(bend) + 32 * np.finfo(float).eps).all()
    large = np.asarray(bend) > 1e-3  # where the bound is above rounding it is not idle either: within a factor 1000
    assert (miss[large] > laws.series_error(bend)[large] / 1000).mean() > 0.5
