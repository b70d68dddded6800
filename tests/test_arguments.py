"""Public functions of the models that get an array, text or a complex number for a number name the argument."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import test_compiled_once

from rvjax import RVErrors, dynamics, four_bar, loaded, mesh_force, tolerances
from rvjax.catalogue import RV_40E, RV_320E
from rvjax.loaded.cases import MACHINE

LOADED = {
    "equilibrium": lambda: loaded.equilibrium(MACHINE, RVErrors(), input_angle=0.1, output_torque=100.0),
    "torsion": lambda: loaded.torsion(MACHINE, RVErrors(), input_angle=0.1, rated_torque=100.0),
    "revolution": lambda: loaded.revolution(MACHINE, RVErrors(), output_torque=100.0),
    "reading": lambda: loaded.reading(None, MACHINE, loaded.Reading(0.1, [0.0]), input_angle=0.1, output_torque=9.0),
}
PACKAGES = {package.__name__.removeprefix("rvjax."): package for package in (*test_compiled_once.PACKAGES, loaded)}
CALLS = {name: calls for name, calls in test_compiled_once.CALLS.items() if not name.startswith("roots.")}
CALLS |= {f"loaded.{name}": [lambda x, call=call: call()] for name, call in LOADED.items()}
BAD = {
    "array": np.array([0.1, 0.2]),
    "list": [0.1, 0.2],
    "array of JAX": jnp.ones(3),
    "text": "0.3",
    "complex": 0.3 + 1j,
    "complex of JAX": jnp.asarray(1j),
    "object": object(),
}


class Seen(Exception):
    """A function was called."""


def numbers_of(name, monkeypatch):
    """The function, and its bound arguments of each way to call it with the names of those that are one number."""
    package, _, short = name.partition(".")
    function, found = getattr(PACKAGES[package], short), []

    def spy(*arguments, **named):
        found.append((arguments, named))
        raise Seen

    with monkeypatch.context() as patch:
        patch.setattr(PACKAGES[package], short, spy)
        for call in CALLS[name]:
            with pytest.raises(Seen):
                call(0.3)
    bound = [inspect.signature(function).bind(*arguments, **named) for arguments, named in found]
    return function, [(one, [k for k, v in one.arguments.items() if isinstance(v, float)]) for one in bound]


@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", CALLS)
def test_a_number_that_is_none_is_refused_by_name(name, bad, monkeypatch):
    function, ways = numbers_of(name, monkeypatch)
    for bound, numbers in ways:
        for argument in numbers:
            wrong = {**bound.arguments, argument: BAD[bad]}
            with pytest.raises(ValueError, match=rf"^{argument}( =|:) .*must be one real number") as error:
                function(**wrong)
            message = str(error.value)
            assert "\n" not in message and len(message) < 150
            assert ("jax.vmap" in message) == (np.ndim(BAD[bad]) > 0)


@pytest.mark.parametrize(
    ("call", "argument"),
    [
        ("lost_motion.hysteresis_loop", "torque"),
        ("life.bearing_life", "force"),
        ("dynamics.speed_sweep", "sun_speeds"),
        ("mesh_force.sweep", "values"),
    ],
)
@pytest.mark.parametrize("bad", [["a", "b"], np.array([1j, 2.0]), [[1.0], [1.0, 2.0]], "text"])
def test_an_array_of_something_else_is_refused_by_name(call, argument, bad, monkeypatch):
    function, ((bound, _), *_) = numbers_of(call, monkeypatch)
    with pytest.raises(ValueError, match=rf"^{argument} = .*must be an array of real numbers$"):
        function(**{**bound.arguments, argument: bad})


def test_tracers_and_numbers_of_every_kind_pass():
    def error(angle):
        return four_bar.transmission_error(RV_40E, RVErrors(), crank_angle=angle).error

    # Arguments are checked before anything is compiled: a trace is enough.
    for angle in (1, 0.5, np.float32(0.5), np.array(0.5), jnp.asarray(0.5)):
        assert jax.eval_shape(lambda angle=angle: error(angle)).shape == ()
    assert jax.eval_shape(error, 1.0).shape == ()
    assert jax.eval_shape(jax.vmap(error), jnp.arange(3.0)).shape == (3,)


COUNTS = {
    "four_bar.revolution": ("angles", lambda n: four_bar.revolution(RV_40E, RVErrors(), angles=n)),
    "loaded.revolution": ("samples", lambda n: loaded.revolution(MACHINE, RVErrors(), output_torque=1.0, samples=n)),
    "dynamics.response": (
        "harmonics",
        lambda n: dynamics.response(RV_320E, sun_speed=1.0, output_torque=1.0, harmonics=n),
    ),
    "mesh_force.cycle_angles": ("samples", lambda n: mesh_force.cycle_angles(25, samples=n)),
    "monte_carlo": ("samples", lambda n: tolerances.monte_carlo(None, None, samples=n, seed=0)),
    "monte_carlo, chunk": ("chunk", lambda n: tolerances.monte_carlo(None, None, samples=9, seed=0, chunk=n)),
    "sobol_indices": ("seed", lambda n: tolerances.sobol_indices(None, None, samples=9, seed=n)),
    "failure_probability": ("samples", lambda n: tolerances.failure_probability(None, None, 0, samples=n, seed=0)),
    "sample": ("seed", lambda n: tolerances.sample(None, seed=n, indices=0)),
}


@pytest.mark.parametrize("bad", [2.5, "3", -1, True, 1e3, np.array([1, 2])], ids=str)
@pytest.mark.parametrize("name", COUNTS)
def test_a_count_that_is_none_is_refused_by_name(name, bad):
    argument, call = COUNTS[name]
    with pytest.raises(ValueError, match=rf"^{argument} = .*: must be a whole number of at least 0$") as error:
        call(bad)
    assert "\n" not in str(error.value)


def test_a_count_of_numpy_passes():
    assert len(mesh_force.cycle_angles(np.int64(5), samples=np.int32(3))) == len(mesh_force.cycle_angles(5, samples=3))
