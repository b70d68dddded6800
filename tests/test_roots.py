"""Root finding against optimistix, an unrolled derivative and closed forms.

Kepler's equation x - e sin x = m stands for a well-behaved scalar root; its derivatives are
dx/dm = 1/(1 - e cos x), d2x/dm2 = -e sin x/(1 - e cos x)^3. Tolerances are those of the last Newton
step (a few machine epsilons).
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, strategies as st

from rvjax import Status, roots


def kepler(x, params):
    e, m = params
    return x - e * jnp.sin(x) - m


def kepler_root(e, m, **options):
    return roots.bracketed(kepler, (e, m), m - e, m + e, **options)


ECCENTRICITY = jnp.linspace(0.05, 0.95, 40)
ANOMALY = jnp.linspace(-3.0, 3.0, 40)


def test_scalar_root_equals_optimistix():
    optimistix = pytest.importorskip("optimistix")  # here, or every worker would load it while it collects

    def theirs(e, m):
        solver = optimistix.Newton(rtol=1e-14, atol=1e-14)
        return optimistix.root_find(kepler, solver, m, args=(e, m), throw=False).value

    def ours(e, m):
        found = kepler_root(e, m)
        return found.value, found.info

    both = (jax.value_and_grad(ours, argnums=(0, 1), has_aux=True), jax.value_and_grad(theirs, argnums=(0, 1)))
    ((value, info), slopes), (due, other) = (jax.jit(jax.vmap(f))(ECCENTRICITY, ANOMALY) for f in both)
    np.testing.assert_allclose(value, due, rtol=1e-13)
    assert np.all(info.status == Status.CONVERGED) and np.max(info.residual) < 1e-15 and np.max(info.steps) <= 9
    for pair in zip(slopes, other):
        np.testing.assert_allclose(*pair, rtol=1e-12)


def test_first_and_second_derivatives_equal_the_closed_form():
    def root(e, m):
        return kepler_root(e, m).value

    firsts = [mode(root, argnums=1) for mode in (jax.grad, jax.jacfwd)]
    seconds = [mode(first, argnums=1) for first in firsts for mode in (jax.jacfwd, jax.grad)]

    @jax.jit
    @jax.vmap
    def every(e, m):
        return root(e, m), [first(e, m) for first in firsts], [second(e, m) for second in seconds]

    x, slopes, bends = every(ECCENTRICITY, ANOMALY)
    x, e = np.asarray(x), np.asarray(ECCENTRICITY)
    q = 1 - e * np.cos(x)
    for slope in slopes:
        np.testing.assert_allclose(slope, 1 / q, rtol=1e-13)
    for bend in bends:
        np.testing.assert_allclose(bend, -e * np.sin(x) / q**3, rtol=1e-11, atol=1e-14)


@pytest.mark.long  # optimistix and the closed form have the same slopes
def test_implicit_derivative_equals_the_unrolled_one():
    def unrolled(e, m):
        x = m
        for _ in range(12):
            x = x - kepler(x, (e, m)) / (1 - e * jnp.cos(x))
        return x

    for argument in (0, 1):
        implicit, plain = (jax.jit(jax.grad(f, argnums=argument)) for f in (lambda *a: kepler_root(*a).value, unrolled))
        np.testing.assert_allclose(implicit(0.4, 2.0), plain(0.4, 2.0), rtol=1e-13)


def cubic(x, p):
    return x**3 - p


def test_a_failed_lane_leaves_the_others_alone():
    good = np.array([0, 2])

    def solve(p):
        return roots.bracketed(cubic, p, 0.0, 10.0)

    def total(p):
        root = jax.vmap(solve)(p)
        return jnp.sum(jnp.where(root.info.status == Status.CONVERGED, root.value, 0.0))

    transforms = [transform(total) for transform in (jax.grad, jax.jacfwd, jax.hessian)]
    every = jax.jit(lambda p: (jax.vmap(solve)(p), *(f(p) for f in transforms)))
    found, gradient, forward, hessian = jax.tree.map(np.asarray, every(np.array([8.0, np.nan, 27.0, 1e9, np.inf])))
    expected = [Status.CONVERGED, Status.NONFINITE, Status.CONVERGED, Status.NO_BRACKET, Status.NONFINITE]
    assert list(found.info.status) == [int(s) for s in expected]
    np.testing.assert_allclose(found.value[good], [2.0, 3.0], rtol=1e-15)
    assert np.all(np.isnan(found.value[np.array([1, 3, 4])]))

    np.testing.assert_allclose(gradient[good], [1 / 12, 1 / 27], rtol=1e-14)
    assert np.all(gradient[np.array([1, 3, 4])] == 0)
    np.testing.assert_array_equal(forward, gradient)
    np.testing.assert_allclose(np.diag(hessian)[good], [-1 / 144, -2 / 27 / 81], rtol=1e-13)
    assert np.all(np.isfinite(hessian))


def test_too_few_steps_is_named():
    assert int(kepler_root(0.9, 1.0, max_steps=2).info.status) == Status.MAX_STEPS


@pytest.mark.parametrize("ends", [(-1.0, 4.0), (4.0, -1.0)])
def test_ends_in_either_order_and_a_root_at_an_end(ends):
    assert float(roots.bracketed(lambda x, p: x - p, 2.5, *ends).value) == 2.5
    assert float(roots.bracketed(lambda x, p: p - x, 4.0, *ends).value) == 4.0


@given(
    root=st.floats(-50, 50).filter(lambda x: abs(x) > 1e-6),
    steepness=st.floats(1e-3, 1e3),
    start=st.floats(-100, 100),
)
def test_any_start_converges_on_functions_that_defeat_plain_newton(root, steepness, start):
    # atan is flat far away: plain Newton diverges from there.
    found = _atan_root(root, steepness, start)
    assert int(found.info.status) == Status.CONVERGED
    assert abs(float(found.value) - root) <= 1e-14 * abs(root) + 1e-300


@jax.jit
def _atan_root(root, steepness, start):
    return roots.bracketed(lambda x, p: jnp.arctan(p[1] * (x - p[0])), (root, steepness), -100.0, 100.0, start=start)


def test_float32_stays_float32():
    single = jnp.float32
    root = kepler_root(single(0.5), single(1.0))
    assert root.value.dtype == single and root.info.residual.dtype == single
    np.testing.assert_allclose(root.value, kepler_root(0.5, 1.0).value, rtol=1e-6)
