"""Elementary functions against mpmath: a few units in the last place, over the whole range; exact derivatives."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

from rvjax._jax import elementary

ULP = 2.0**-52


sin_cos, arctan2 = jax.jit(elementary.sin_cos), jax.jit(elementary.arctan2)


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
    assert error(jax.jit(elementary.log)(numbers), exact) < 2.5 * ULP
    single = numbers[(numbers > 1e-37) & (numbers < 1e37)].astype(np.float32)
    assert jax.jit(elementary.log)(single).dtype == jnp.float32
    np.testing.assert_allclose(jax.jit(elementary.log)(single), np.log(single.astype(float)), rtol=4e-7, atol=1e-7)


@pytest.mark.parametrize("exponent", [10 / 9, 1.9, 0.1, -0.1])
def test_powers(exponent):
    """The error of the logarithm counts absolutely: |exponent log x| units in the last place."""
    x = 10 ** np.random.default_rng(1).uniform(-60, 60, 500)
    with mpmath.workprec(120):
        exact = [mpmath.mpf(v) ** mpmath.mpf(exponent) for v in x]
    found = jax.jit(lambda x: elementary.power(x, exponent))(x)
    assert error(found, exact) < (2 + np.abs(exponent * np.log(x)).max()) * ULP
    assert float(elementary.power(jnp.zeros(()), exponent)) == 0


def test_sine_and_cosine():
    """Two units in the last place, absolute near the zeros, up to 1e5; then the angle's own rounding counts as well."""
    rng = np.random.default_rng(2)
    quarters = np.pi / 2 * np.arange(-40, 41)
    x = np.concatenate([rng.uniform(-10, 10, 500), rng.uniform(-1e5, 1e5, 500), 1e-9 * rng.normal(size=50), quarters])
    x = np.concatenate([x, rng.uniform(-1, 1, 500) * elementary.LARGEST_ANGLE ** rng.uniform(0.3, 1, 500)])
    sine, cosine = sin_cos(x)
    allowed = np.where(np.abs(x) < 1e5, 2 * ULP, 2 * ULP + ULP * np.abs(x) / 2)
    with mpmath.workprec(150):
        for found, exact in ((sine, mpmath.sin), (cosine, mpmath.cos)):
            off = [abs(float(mpmath.mpf(float(a)) - exact(mpmath.mpf(b)))) for a, b in zip(found, x)]
            assert np.all(np.asarray(off) < allowed)
    tiny = 10 ** rng.uniform(-300, -5, 100)
    odd = np.concatenate([tiny, [-0.0, np.nan, np.inf]])
    found = np.asarray(sin_cos(odd))
    np.testing.assert_allclose(found[0, :100], tiny, rtol=1e-10)
    assert np.signbit(found[0, 100]) and np.isnan(found[:, 101:]).all()
    np.testing.assert_allclose(sin_cos(x[:500].astype(np.float32))[0], np.sin(x[:500]), atol=1e-6)


def test_angle_of_a_vector():
    """Three units in the last place over all quadrants and three hundred decades; zeros keep their signs."""
    rng = np.random.default_rng(3)
    size = 10 ** rng.uniform(-150, 150, 1000)
    close = np.array([1, 1, -1, -1]) * (1 + 1e-12 * np.arange(4)), np.array([1.0, -1, 1, -1])  # diagonals
    y = np.concatenate([rng.normal(size=1000), rng.normal(size=500) * size[:500], close[0]])
    x = np.concatenate([rng.normal(size=1000), size[500:], close[1]])
    with mpmath.workprec(150):
        exact = [mpmath.atan2(mpmath.mpf(a), mpmath.mpf(b)) for a, b in zip(y, x)]
    assert error(arctan2(y, x), exact) < 3 * ULP
    y, x = (np.ravel(v) for v in np.meshgrid([0.0, -0.0, 1, -1], [0.0, -0.0, 1, -1]))
    found = arctan2(y, x)
    np.testing.assert_allclose(found, np.arctan2(y, x), rtol=2 * ULP)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(y))
    assert np.isnan(arctan2(np.array([np.nan, 1]), np.array([1, np.nan]))).all()
    single = arctan2(jnp.float32(1), jnp.float32(-2))
    assert single.dtype == jnp.float32 and abs(float(single) - np.arctan2(1, -2)) < 1e-6


def test_quotient():
    """Rounded correctly or to the neighbour: off by nothing or by one unit in the last place, 0.5 to 1 ULP."""
    rng = np.random.default_rng(4)
    x, y = rng.normal(size=1000) * 10 ** rng.uniform(-140, 140, 1000), 10 ** rng.uniform(-140, 140, 1000)
    np.testing.assert_allclose(jax.jit(elementary.divide)(x, y), x / y, rtol=1.01 * ULP)
    assert float(elementary.divide(jnp.asarray(1.0), jnp.asarray(0.0))) == 0
    assert float(elementary.divide(jnp.float32(1), jnp.float32(3))) == np.float32(1) / np.float32(3)


def test_the_slope_at_the_bound_of_a_number_without_sign():
    value, slope = jax.vmap(jax.value_and_grad(elementary.nonnegative))(jnp.asarray([-1.0, 0.0, 2.0]))
    assert value.tolist() == [0, 0, 2] and slope.tolist() == [0, 1, 1]
    assert np.isnan(elementary.nonnegative(jnp.nan))


def test_derivatives():
    x, angle, away = np.array([1e-30, 0.3, 1.0, 7e20]), np.linspace(-4, 4, 9), np.full(9, -2.0)

    def slope(function, *at, argnums=0):
        return jax.vmap(jax.grad(function, argnums=argnums))(*at)

    @jax.jit
    def every(x, angle, away):
        return dict(
            log=slope(elementary.log, x),
            bend=slope(jax.grad(elementary.log), x),
            power=slope(lambda x: elementary.power(x, 1.9), x),
            sine=slope(lambda x: elementary.sin_cos(x)[0], angle),
            cosine=slope(lambda x: elementary.sin_cos(x)[1], angle),
            angle=slope(elementary.arctan2, angle, away, argnums=(0, 1)),
            zeros=(jax.grad(lambda x: elementary.power(x, 0.9))(0.0), jax.grad(elementary.arctan2)(0.0, 0.0)),
        )

    found = every(x, angle, away)
    np.testing.assert_allclose(found["log"], 1 / x, rtol=1e-15)
    np.testing.assert_allclose(found["power"], 1.9 * x**0.9, rtol=1e-13)
    np.testing.assert_allclose(found["bend"], -1 / x**2, rtol=1e-15)
    np.testing.assert_allclose(found["sine"], np.cos(angle), rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(found["cosine"], -np.sin(angle), rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(found["angle"][0], -2 / (4 + angle**2), rtol=1e-15)
    np.testing.assert_allclose(found["angle"][1], -angle / (4 + angle**2), rtol=1e-15)
    assert found["zeros"] == (0, 0)
