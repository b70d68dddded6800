"""Derivatives of the loaded equilibrium against differences of the plain value.

Central differences of fourth order. Their rounding is 1e-13 of a value over the step, their truncation the fourth power
of a step that is 1e-4 of what is stepped; a contact that changes sides within a step spoils more: 1e-5 relative to the
larger, beside what rounding leaves.
"""

import jax
import jax.numpy as jnp
import numpy as np
from loaded_cases import NAMED, design_of, errors_of

from rvjax import loaded

CASE = NAMED["rv40: all errors, rated, hertz"]
FLOATS = lambda tree: jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)  # noqa: E731
START = (FLOATS(design_of(CASE)), FLOATS(errors_of(CASE, design_of(CASE))), jnp.float64(412.0), jnp.float64(576.525))
UNREAD = ("module", "centre_distance", "sun_radius", "disc_phase", "output_torsion", "pin_position", "disc_runout")


@jax.jit
def outputs(inputs):
    design, errors, torque, angle = inputs
    r = loaded.equilibrium(design, errors, input_angle=angle, output_torque=torque)
    parts = (1e4 * r.error, r.input_torque, r.stiffness / 1e6, jnp.sum(r.pressure**2) / 1e19, r.pins[0, 25] / 1e3)
    return jnp.stack([*parts, r.disc_bearing[0, 1, 0] / 1e3, r.support_bearing[1, 0] / 1e3, r.disc_torque[1] / 1e2])


@jax.jit
def forward(inputs, tangent):
    return jax.jvp(outputs, (inputs,), (tangent,))[1]


@jax.jit
def backward(inputs, weights):
    return jax.vjp(outputs, inputs)[1](weights)[0]


def fields():
    paths = jax.tree_util.tree_leaves_with_path(START)
    return [(number, path[-1].name if len(path) > 1 else "condition") for number, (path, _) in enumerate(paths)]


def along(number, direction, size):
    leaves, tree = jax.tree.flatten(START)
    leaves[number] = leaves[number] + size * direction
    return jax.tree.unflatten(tree, leaves)


def test_forward_derivatives_to_every_input_agree_with_differences():
    random = np.random.default_rng(0)
    leaves, tree = jax.tree.flatten(START)
    for number, name in fields():
        leaf = leaves[number]
        direction = jnp.asarray(random.standard_normal(leaf.shape))
        tangent = [jnp.zeros_like(x) for x in leaves]
        tangent[number] = direction
        slope = forward(START, jax.tree.unflatten(tree, tangent))
        if name in UNREAD:
            assert np.all(np.asarray(slope) == 0), name
            continue
        in_design = number < len(jax.tree.leaves(START[0]))
        step = 1e-5 * float(jnp.max(jnp.abs(leaf))) if in_design or name == "condition" else 1e-9
        step = max(step, 1e-9) if name != "crank_phase" else 1e-7
        near, far = (
            (outputs(along(number, direction, s)) - outputs(along(number, direction, -s))) for s in (step, 2 * step)
        )
        expected = (8 * near - far) / (12 * step)
        noise = 1e-12 * np.abs(np.asarray(outputs(START))) / step
        bound = 1e-5 * np.maximum(np.abs(slope), np.max(np.abs(slope)) * 1e-3) + 10 * noise
        assert np.all(np.abs(np.asarray(expected - slope)) <= bound), (name, slope, expected)


def test_reverse_derivatives_are_the_transpose():
    random = np.random.default_rng(1)
    tangent = jax.tree.map(
        lambda x: jnp.asarray(random.standard_normal(x.shape)) * (1e-9 + 1e-3 * jnp.max(jnp.abs(x))), START
    )
    weights = jnp.asarray(random.standard_normal(8))
    pulled = backward(START, weights)
    one = sum(jnp.vdot(a, b) for a, b in zip(jax.tree.leaves(pulled), jax.tree.leaves(tangent)))
    np.testing.assert_allclose(one, weights @ forward(START, tangent), rtol=1e-9)
    for (_, name), leaf in zip(fields(), jax.tree.leaves(pulled)):
        if name in UNREAD:
            assert np.all(np.asarray(leaf) == 0), name


def test_derivatives_of_failed_and_idle_cases_are_finite():
    """NaN among the errors: its lane has derivative zero. No errors and no torque: finite."""
    design, errors, _, angle = START
    for torque, radius in ((412.0, jnp.nan), (412.0, 0.02), (0.0, 0.0)):
        spoilt = jax.tree.map(lambda leaf: 0.0 * leaf, errors).replace(pin_radius=jnp.asarray(radius, float))
        pulled = backward((design, spoilt, jnp.float64(torque), angle), jnp.ones(8))
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(pulled)), (torque, radius)
