"""Cost of the derivative of a root: implicit against unrolled, next to the primal.

Kepler's equation, 100,000 batch elements.
Target: gradient of the batch mean <= 2 x the batch mean.
"""

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.timing import alternate, arguments, publish, settings

settings()

from rvjax import roots  # noqa: E402  (after the flags)

STEPS = 12  # of the unrolled iteration, as many as the slowest element needs


def kepler(x, params):
    e, m = params
    return x - e * jnp.sin(x) - m


def kepler_mean(e, m):
    solve = jax.vmap(lambda e, m: roots.bracketed(kepler, (e, m), m - e, m + e, start=m).value)
    return jnp.mean(solve(e, m))


def kepler_mean_unrolled(e, m):
    x = m
    for _ in range(STEPS):
        x = x - kepler(x, (e, m)) / (1 - e * jnp.cos(x))
    return jnp.mean(x)


def main() -> None:
    options = arguments(__doc__)
    rng = np.random.default_rng(0)
    orbit = jax.device_put((rng.uniform(0.05, 0.8, 100_000), rng.uniform(-3, 3, 100_000)))
    functions = {
        "scalar": (kepler_mean, orbit),
        "scalar_gradient": (jax.grad(kepler_mean, argnums=(0, 1)), orbit),
        "unrolled": (kepler_mean_unrolled, orbit),
        "unrolled_gradient": (jax.grad(kepler_mean_unrolled, argnums=(0, 1)), orbit),
    }
    jitted = {name: (jax.jit(f), data) for name, (f, data) in functions.items()}
    implicit = jitted["scalar_gradient"][0](*orbit)
    unrolled = jitted["unrolled_gradient"][0](*orbit)
    np.testing.assert_allclose(implicit[0], unrolled[0], rtol=1e-9, atol=1e-18)
    best = alternate({name: (lambda f=f, data=data: f(*data)) for name, (f, data) in jitted.items()})
    figures = {f"{name}_ns_per_lane": 1e9 * best[name] / len(jitted[name][1][0]) for name in best}
    figures["scalar_gradient_ratio"] = best["scalar_gradient"] / best["scalar"]
    figures["unrolled_gradient_ratio"] = best["unrolled_gradient"] / best["unrolled"]
    figures["unrolled_gradient_over_implicit"] = best["unrolled_gradient"] / best["scalar_gradient"]
    publish("roots", figures, options.json)


if __name__ == "__main__":
    main()
