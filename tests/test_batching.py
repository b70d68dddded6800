"""Functions of whole batches: traced once, whatever the levels of `jax.vmap`."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax._jax.kernels import BatchedKernel, along_lanes


def late():
    """Sum over the elements of a row (batch, n), which says how often it was traced."""
    traced = []

    def function(x):
        traced.append(x.shape)
        return jnp.sum(x, axis=1)

    made = BatchedKernel(function, lambda x: jax.ShapeDtypeStruct(x.shape[:1], x.dtype))
    made.rule = lambda size, batched, x: made(x.reshape(-1, x.shape[-1])).reshape(size, -1)
    return made, traced


@pytest.mark.parametrize("levels", [0, 1, 2, 3])
def test_a_function_is_traced_once_at_any_level(levels):
    made, traced = late()
    x = np.random.default_rng(0).normal(size=(*(2, 3, 4)[:levels], 5))
    many = lambda row: made(row[None])[0]  # noqa: E731
    for _ in range(levels):
        many = jax.vmap(many)
    program = jax.jit(many)
    np.testing.assert_allclose(program(x), x.sum(axis=-1), rtol=1e-14)
    np.testing.assert_allclose(program(2 * x), 2 * x.sum(axis=-1), rtol=1e-14)
    assert traced == [(int(np.prod(x.shape[:-1])), 5)]


def test_a_batch_along_another_axis_is_its_cases():
    made, _ = late()
    x = np.arange(30.0).reshape(2, 3, 5)
    np.testing.assert_allclose(jax.vmap(made, in_axes=1)(x), x.sum(axis=-1).T)
    np.testing.assert_allclose(made(jnp.asarray(x[0])), x[0].sum(axis=-1))  # outside of any program


def test_second_derivatives_of_a_function_along_lanes_are_exact():
    """Forward derivatives batch the tangents alone."""
    one = lambda x: along_lanes(lambda x: jnp.sin(x) * x)(x[None])[0]  # noqa: E731
    x = jnp.array([0.0, 1.0, 2.0])
    np.testing.assert_allclose(jax.vmap(jax.jacfwd(one))(x), np.sin(x) + x * np.cos(x), atol=1e-15)
    second = jax.vmap(jax.jacfwd(jax.jacfwd(one)))(x)
    np.testing.assert_allclose(second, 2 * np.cos(x) - x * np.sin(x), rtol=1e-14)
    np.testing.assert_allclose(jax.jacfwd(jax.jacfwd(jax.vmap(one)))(x)[1, 1, 1], second[1], rtol=1e-14)
