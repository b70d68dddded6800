"""Measure whether `rvjax._jax.elementary` still pays on the installed JAX: each function next to that of JAX.

Each is used as in the models: its result feeds arithmetic that uses it twice. Run on one core (`taskset -c 0`).
"""

import numpy as np

from benchmarks.timing import alternate, arguments, compiled, publish, settings

settings()

import jax.numpy as jnp  # noqa: E402

from rvjax._jax import elementary  # noqa: E402

NUMBERS = 65_536


def used(function):
    """Both results of a pair, or the one, in arithmetic behind the function."""

    def program(*x):
        found = function(*x)
        first, second = found if isinstance(found, tuple) else (found, found)
        return x[0] * first + second * second

    return program


PAIRS = {
    "sin_cos": (elementary.sin_cos, lambda x: (jnp.sin(x), jnp.cos(x))),
    "arctan2": (elementary.arctan2, jnp.arctan2),
    "log": (elementary.log, jnp.log),
    "power": (lambda x: elementary.power(x, 1.9), lambda x: x**1.9),
    "divide": (elementary.divide, lambda x, y: x / y),
}


def main():
    path = arguments(__doc__.splitlines()[0]).json
    rng = np.random.default_rng(0)
    figures = {}
    for name, (ours, theirs) in PAIRS.items():
        x = [jnp.asarray(rng.uniform(0.1, 10, NUMBERS)) for _ in range(2 if name in ("arctan2", "divide") else 1)]
        fast, plain = (compiled(used(function), *x)[0] for function in (ours, theirs))
        np.testing.assert_allclose(fast(*x), plain(*x), rtol=1e-12, atol=1e-12)
        best = alternate({"ours": lambda f=fast, x=x: f(*x), "jax": lambda f=plain, x=x: f(*x)})
        figures[f"{name}_ns"] = 1e9 * best["ours"] / NUMBERS
        figures[f"{name}_jax_over_ours"] = best["jax"] / best["ours"]
    publish("elementary", figures, path)


if __name__ == "__main__":
    main()
