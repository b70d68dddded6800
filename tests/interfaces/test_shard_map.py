"""Every public function within `jax.shard_map` with its default checks: values and derivatives as with `jax.vmap`.

Tracing is where the checks are. One device makes them too, so that no process with several is needed.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import test_compiled_once
from jax.sharding import Mesh, PartitionSpec as P

from rvjax import RVErrors, loaded
from rvjax.loaded.cases import MACHINE

units = test_compiled_once.units
CALLS = {name: calls for name, calls in test_compiled_once.CALLS.items() if name != "mesh_force.cycle_angles"}
CALLS |= {  # where all but one number are the same on all devices, and where no number is
    "loaded.equilibrium": [
        lambda x: loaded.equilibrium(MACHINE, RVErrors(), input_angle=0.3, output_torque=100 * x),
        lambda x: loaded.equilibrium(MACHINE, units(x), input_angle=0.3, output_torque=100.0),
    ],
    "loaded.torsion": [lambda x: loaded.torsion(MACHINE, RVErrors(), input_angle=0.1, rated_torque=100 * x)],
    "loaded.revolution": [lambda x: loaded.revolution(MACHINE, units(x), output_torque=100.0, samples=2)],
    "loaded.clearance": [lambda x: loaded.clearance(MACHINE, units(x), samples=4)],
}
XS = jnp.array([0.3, 0.7])


def mapped(function):
    mesh = Mesh(np.array(jax.devices()[:1]), ("i",))
    return jax.shard_map(jax.vmap(function), mesh=mesh, in_specs=P("i"), out_specs=P("i"))


def with_slopes(call):
    def total(x):
        found = call(x)
        real = [leaf for leaf in jax.tree.leaves(found) if jnp.issubdtype(jnp.result_type(leaf), jnp.floating)]
        return sum((jnp.sum(leaf) for leaf in real), 0 * x), found

    return jax.value_and_grad(total, has_aux=True)


# Searches, turns and sums over what `loaded.equilibrium`, `running.losses`, `four_bar.revolution`, `dynamics.response`,
# `dynamics.periodic`, `dynamics.speed_sweep` and `mesh_force.solve` trace, or parts of it.
LONG = ("life.rated_torque", "life.rating", "running.hysteresis", "running.back_driving", "running.joint")
LONG += ("loaded.revolution", "loaded.torsion", "four_bar.transmission_error", "four_bar.figures", "mesh_force.sweep")
LONG += ("dynamics.transmission_error", "dynamics.log_sensitivities", "dynamics.speed_range")
LONG += ("dynamics.error_statistics", "dynamics.error_excitation", "dynamics.error_transfer", "dynamics.floquet")
LONG += ("dynamics.constant_forcing", "mesh_force.cycle_statistics")


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.long] * (n in LONG)) for n in CALLS])
def test_values_and_slopes_pass_the_checks(name, thorough):
    for call in CALLS[name] if thorough else CALLS[name][-1:]:
        assert all(leaf.shape[0] == len(XS) for leaf in jax.tree.leaves(jax.eval_shape(mapped(with_slopes(call)), XS)))


WHOLE = ("mesh_force.solve", "life.bearing_life", "loaded.equilibrium")  # compile long; by default a root and its slope


@pytest.mark.parametrize("name", ["roots.bracketed", *(pytest.param(n, marks=pytest.mark.long) for n in WHOLE)])
def test_values_and_slopes_are_those_of_vmap(name):
    function = with_slopes(CALLS[name][-1])
    found, right = jax.jit(mapped(function))(XS), jax.jit(jax.vmap(function))(XS)
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-300), found, right)
