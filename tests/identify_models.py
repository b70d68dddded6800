"""Models and priors of the tests of `rvjax.identify`."""

import jax
import jax.numpy as jnp
import numpy as np

from rvjax import identify
from rvjax.tolerances import Tolerance

Noise, unit = identify.Noise, Tolerance.symmetric

THREE = {"a": unit(3.0), "b": unit(3.0), "c": unit(3.0)}
"""Three errors of spread 1."""

G = np.array([[2.0, 2.0, 0.0], [1.0, 1.0, 0.0], [0.5, 0.5, 0.0], [-1.0, -1.0, 0.0]])
"""Slopes of which the first two are equal and the third vanishes."""


def line(values):
    """Four rows, linear."""
    return jnp.asarray(G) @ jnp.stack([values["a"], values["b"], values["c"]])


def solved(data, prior=THREE, **options):
    """A unit of the linear model; few draws, for the same program serves every test."""
    return identify.solve(line, prior, data, **(dict(noise=Noise(0.5), starts=2, draws=128) | options))


def many(data, **options):
    return identify.solve_many(line, THREE, data, noise=Noise(0.5), **options)


def prior_of(given):
    """A dict of tolerances from a reference case."""
    return {
        name: Tolerance(
            options["lower"],
            options["upper"],
            **{
                key: tuple(value) if key == "shape" else value
                for key, value in options.items()
                if key not in ("lower", "upper")
            },
        )
        for name, options in given.items()
    }


def linear(matrix, constant, fields):
    """values -> constant + G e, with arrays or dicts of them by group; e holds the fields one after the other."""

    def model(values):
        e = jnp.concatenate([jnp.ravel(jnp.asarray(values[name])) for name in fields])
        return jax.tree.map(lambda g, c: c + jnp.asarray(g) @ e, matrix, constant)

    return model


def model_of(name, a):
    """The curved models of the reference cases, of fields a and b."""
    models = {
        "square": lambda x, y: jnp.stack([a[0] * x**2]),
        "fold": lambda x, y: jnp.stack([a[0] * jnp.abs(x + a[1] * y)]),
        "play": lambda x, y: jnp.stack([a[0] * jnp.maximum(0.0, x - a[1] * y), a[0] * a[2] * y]),
        "bend": lambda x, y: jnp.stack([a[0] * x + a[1] * x**2, a[0] * y + a[2] * x * y]),
        "soft": lambda x, y: jnp.stack([a[0] * x + a[1] * (jnp.sqrt(x**2 + a[2] ** 2) - a[2])]),
    }
    return lambda values: models[name](values["a"], values.get("b", 0.0))
