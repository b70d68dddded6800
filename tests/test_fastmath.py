"""Logarithm and powers against mpmath: a few units in the last place, over the whole range; exact derivatives."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from rvjax import fastmath

ULP = 2.0**-52


def error(found, exact):
    return max(float(abs((mpmath.mpf(float(a)) - b) / b)) if b else abs(float(a)) for a, b in zip(found, exact))


@pytest.fixture(scope="module")
def numbers():
    rng = np.random.default_rng(0)
    edges = [1.0, 0.5, 2.0, np.sqrt(0.5), np.nextafter(np.sqrt(0.5), 0), np.nextafter(1, 0), np.nextafter(1, 2)]
    return np.concatenate([10 ** rng.uniform(-307, 308, 500), 1 + 1e-3 * rng.normal(size=500), edges])


def test_logarithm(numbers):
    with mpmath.workprec(120):
        exact = [mpmath.log(mpmath.mpf(x)) for x in numbers]
    assert error(jax.jit(fastmath.log)(numbers), exact) < 2.5 * ULP
    single = numbers[(numbers > 1e-37) & (numbers < 1e37)].astype(np.float32)
    assert jax.jit(fastmath.log)(single).dtype == jnp.float32
    np.testing.assert_allclose(jax.jit(fastmath.log)(single), np.log(single.astype(float)), rtol=4e-7, atol=1e-7)


@pytest.mark.parametrize("exponent", [10 / 9, 1.9, 0.1, -0.1])
def test_powers(exponent):
    """The error of the logarithm counts absolutely: |exponent log x| units in the last place."""
    x = 10 ** np.random.default_rng(1).uniform(-60, 60, 500)
    with mpmath.workprec(120):
        exact = [mpmath.mpf(v) ** mpmath.mpf(exponent) for v in x]
    found = jax.jit(lambda x: fastmath.power(x, exponent))(x)
    assert error(found, exact) < (2 + np.abs(exponent * np.log(x)).max()) * ULP
    assert float(fastmath.power(jnp.zeros(()), exponent)) == 0


def test_derivatives():
    x = np.array([1e-30, 0.3, 1.0, 7e20])
    log, power = (jax.jit(jax.vmap(jax.grad(f))) for f in (fastmath.log, lambda x: fastmath.power(x, 1.9)))
    np.testing.assert_allclose(log(x), 1 / x, rtol=1e-15)
    np.testing.assert_allclose(power(x), 1.9 * x**0.9, rtol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(jax.grad(fastmath.log)))(x), -1 / x**2, rtol=1e-15)
    assert float(jax.grad(lambda x: fastmath.power(x, 0.9))(0.0)) == 0
