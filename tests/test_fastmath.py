"""Elementary functions against mpmath: a few units in the last place, over the whole range; exact derivatives."""

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


def test_sine_and_cosine():
    """Two units in the last place, absolute near the zeros: up to 1e5 the reduction keeps 1e-16 of a turn."""
    rng = np.random.default_rng(2)
    quarters = np.pi / 2 * np.arange(-40, 41)
    x = np.concatenate([rng.uniform(-10, 10, 500), rng.uniform(-1e5, 1e5, 500), 1e-9 * rng.normal(size=50), quarters])
    sine, cosine = jax.jit(fastmath.sin_cos)(x)
    with mpmath.workprec(150):
        for found, exact in ((sine, mpmath.sin), (cosine, mpmath.cos)):
            off = [abs(float(mpmath.mpf(float(a)) - exact(mpmath.mpf(b)))) for a, b in zip(found, x)]
            assert max(off) < 2 * ULP
    tiny = 10 ** rng.uniform(-300, -5, 100)
    np.testing.assert_allclose(fastmath.sin_cos(tiny)[0], tiny, rtol=1e-10)
    assert np.signbit(fastmath.sin_cos(jnp.asarray(-0.0))[0])
    assert np.isnan(fastmath.sin_cos(jnp.asarray([np.nan, np.inf]))).all()
    np.testing.assert_allclose(fastmath.sin_cos(x[:500].astype(np.float32))[0], np.sin(x[:500]), atol=1e-6)


def test_inverse_tangent():
    rng = np.random.default_rng(3)
    x = np.concatenate([10 ** rng.uniform(-300, 300, 500), rng.uniform(-3, 3, 500), [1.0, -1.0, 5e-324]])
    with mpmath.workprec(150):
        exact = [mpmath.atan(mpmath.mpf(v)) for v in x]
    assert error(jax.jit(fastmath.arctan)(x), exact) < 4 * ULP
    special = fastmath.arctan(jnp.asarray([0.0, -0.0, np.inf, -np.inf, np.nan]))
    np.testing.assert_array_equal(special, np.arctan([0.0, -0.0, np.inf, -np.inf, np.nan]))
    np.testing.assert_array_equal(np.signbit(special[:2]), [False, True])


def test_derivatives():
    x = np.array([1e-30, 0.3, 1.0, 7e20])
    log, power = (jax.jit(jax.vmap(jax.grad(f))) for f in (fastmath.log, lambda x: fastmath.power(x, 1.9)))
    np.testing.assert_allclose(log(x), 1 / x, rtol=1e-15)
    np.testing.assert_allclose(power(x), 1.9 * x**0.9, rtol=1e-13)
    np.testing.assert_allclose(jax.vmap(jax.grad(jax.grad(fastmath.log)))(x), -1 / x**2, rtol=1e-15)
    assert float(jax.grad(lambda x: fastmath.power(x, 0.9))(0.0)) == 0
    angle = np.linspace(-4, 4, 9)
    sine, cosine = (jax.vmap(jax.grad(lambda x, k=k: fastmath.sin_cos(x)[k]))(angle) for k in (0, 1))
    np.testing.assert_allclose(sine, np.cos(angle), rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(cosine, -np.sin(angle), rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(jax.vmap(jax.grad(fastmath.arctan))(angle), 1 / (1 + angle**2), rtol=1e-15)
