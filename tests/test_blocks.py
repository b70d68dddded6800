"""Sizes of blocks and calls by platform; programs are lowered for a GPU on a computer without one.

What a GPU computes is compared by `benchmarks/gpu.py`.
"""

import re
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import RVErrors, catalogue, commands, loaded
from rvjax._jax import sizes
from rvjax._jax.kernels import settle
from rvjax.mesh_force.equilibrium import equilibrium
from rvjax.mesh_force.geometry import Case
from rvjax.population import Population, Tolerance
from rvjax.records import Record, field, record
from rvjax.response import Evaluator, derivatives, units_devices, units_on
from rvjax.response.response import mesh_of

CASES = 96  # equilibria: more than one block of a processor


def lowered(function, platform, *shapes):
    """Text of the program for a platform."""
    given = [jax.ShapeDtypeStruct(shape, jnp.float64) for shape in shapes]
    return jax.export.export(jax.jit(jax.vmap(function)), platforms=[platform])(*given).mlir_module()


def carried(text):
    """Shapes of the numbers that the loops of a program carry."""
    loops = re.findall(r"stablehlo\.while\(.*\) : (.*)", text)
    return {shape for types in loops for shape in re.findall(r"tensor<([\dx]+)xf64>", types)}


@pytest.mark.long  # roller forces below are cut alike
@pytest.mark.parametrize(("platform", "lanes", "other"), [("cpu", 64, CASES), ("cuda", CASES, 64)])
def test_equilibria_are_one_block_of_a_gpu(platform, lanes, other):
    """Forces of 2 x 40 pins in the Newton loop; a processor's block has 64 cases."""

    def error(clearance):
        errors = RVErrors(bearing_clearance=clearance)
        return loaded.equilibrium(catalogue.RV_40E_WHOLE, errors, input_angle=0.1, output_torque=412.0).error

    text = lowered(error, platform, (CASES,))
    assert f"2x40x{lanes}" in carried(text) and f"2x40x{other}" not in carried(text)
    branches = text.count("stablehlo.case")  # `stored` writes to memory by a branch, on a processor only
    assert branches > 10 if platform == "cpu" else branches < 10


@pytest.mark.parametrize(("platform", "lanes", "other"), [("cpu", 192, 600), ("cuda", 600, 192)])
def test_roller_forces_are_one_block_of_a_gpu(platform, lanes, other):
    def windup(*numbers):
        return equilibrium("hertz", 5, Case(*numbers)).windup

    shapes = [(600, 6) if name == "radius_error" else (600,) for name in Case._fields]
    found = carried(lowered(windup, platform, *shapes))
    assert f"6x{lanes}" in found and f"6x{other}" not in found


@pytest.mark.parametrize(("platform", "loops"), [("cpu", 1), ("cuda", 0)])
def test_a_gpu_stores_nothing_on_purpose(platform, loops):
    assert lowered(lambda x: settle(2 * x) + 1, platform, (7,)).count("stablehlo.while") == loops


def test_rows_are_filled_up():
    rows = np.arange(10.0).reshape(5, 2)
    np.testing.assert_array_equal(sizes.padded(rows, 4), rows[[0, 1, 2, 3, 4, 4, 4, 4]])
    np.testing.assert_array_equal(sizes.padded(rows, 4, fill=7)[5:], np.full((3, 2), 7.0))
    np.testing.assert_array_equal(sizes.padded(rows, 3, axis=1), rows[:, [0, 1, 1]])
    assert sizes.padded(rows, 5) is rows and sizes.padded(rows[:0], 4).shape == (0, 2)
    traced = jax.jit(lambda x: sizes.padded(x, 3, axis=-1))(rows)
    np.testing.assert_array_equal(traced, rows[:, [0, 1, 1]])
    np.testing.assert_array_equal(sizes.calls(5, 3), [[0, 1, 2], [3, 4, 4]])
    assert sizes.calls(0, 3).shape == (0, 3)


@record
class Costly(Record):
    """A unit that counts as costly."""

    size: object = field("-", "factor")

    @property
    def costly(self):
        return True

    def __call__(self, errors):
        return {"y": self.size * jnp.sin(errors["a"]) + errors["b"] ** 2}


POPULATION = Population.of({"a": Tolerance.symmetric(0.3), "b": Tolerance.symmetric(1.0)})


@pytest.mark.parametrize(("platform", "solved", "sloped"), [("cpu", 256, 256), ("gpu", 4096, 2048)])
def test_calls_of_a_gpu_are_larger_and_give_the_same(monkeypatch, platform, solved, sloped):
    """300 units, solved and with gradients, in calls of the size of the platform of their devices."""
    seen = []

    def noting(call):
        def noted(response, population, errors, *rest, **static):
            seen.append(errors.shape[1])
            return call(response, population, errors, *rest, **static)

        return noted

    errors = np.random.default_rng(0).normal(size=(2, 300))
    take = lambda units: jnp.asarray(errors[:, units])  # noqa: E731
    monkeypatch.setattr(derivatives, "units_devices", lambda: [SimpleNamespace(platform=platform)])
    for name in ("_solved", "_pulled"):
        monkeypatch.setattr(derivatives, name, noting(getattr(derivatives, name)))
    response = Costly(2.0)
    values, status, state = derivatives.solve(response, POPULATION, 300, take)
    slopes = derivatives.pulls(response, POPULATION, errors, state, np.ones((1, 300)))
    assert seen == [solved] * -(-300 // solved) + [sloped] * -(-300 // sloped)
    np.testing.assert_allclose(values[0], 2 * np.sin(errors[0]) + errors[1] ** 2, rtol=1e-14)
    np.testing.assert_allclose(slopes, [2 * np.cos(errors[0]), 2 * errors[1]], rtol=1e-14)
    assert status.shape == (300,)


def test_units_go_to_the_devices_that_are_named_and_nothing_else_does():
    """An array that was put on a device takes its program there: JAX calls it committed."""
    here = jax.devices("cpu")[:1]
    of_chunk = lambda: Evaluator(lambda e: e["a"] + e["b"], POPULATION, 0, "random", 50).start(0)[0][""]  # noqa: E731
    plain = of_chunk()
    with units_on(here):
        assert units_devices() == here and mesh_of(256) is None
        placed = of_chunk()
        (values, *_) = derivatives.solve(Costly(2.0), POPULATION, 5, lambda units: jnp.zeros((2, len(units))))
        assert not jnp.zeros(3).committed
    assert placed.committed and not plain.committed and values.shape == (1, 5)
    np.testing.assert_array_equal(placed, plain)
    assert sizes.platform_of([1.0, placed]) == "cpu" and units_devices() == jax.local_devices()


GPUS = [SimpleNamespace(platform="gpu", device_kind="H100")] * 2


@pytest.mark.parametrize(
    ("named", "there", "seconds", "due"),
    [
        (None, GPUS[:1], 60.0, "H100"),
        (None, GPUS, 60.0, "H100, 2 devices"),
        (None, GPUS[:1], 0.1, "the processor"),  # too few units to gain
        (None, GPUS[:1], None, "the processor"),
        ("cuda,cpu", GPUS[:1], 0.1, "H100"),
        ("cpu", [], 60.0, "the processor"),
        (None, [], 60.0, "the processor"),
    ],
)
def test_many_units_go_to_a_gpu_unless_a_platform_is_named(monkeypatch, named, there, seconds, due):
    def local(backend=None):
        if backend == "gpu" and not there:
            raise RuntimeError("Unknown backend")
        return there if backend == "gpu" else before()

    before = jax.local_devices
    monkeypatch.setenv("JAX_PLATFORMS", named or "")
    monkeypatch.setattr(jax, "local_devices", local)
    with commands.units_placed(lambda: seconds) as device:
        assert device == due and units_devices() == (there if due.startswith("H100") else before())
    assert units_devices() == before()


def test_only_commands_with_many_units_may_start_a_gpu(monkeypatch):
    monkeypatch.setattr(commands, "find_spec", lambda _: "installed")
    assert commands.may_use_gpu("montecarlo", 1) and commands.may_use_gpu("allocate", 1)
    assert not commands.may_use_gpu("check", 1) and not commands.may_use_gpu("montecarlo", 3)
    monkeypatch.setattr(commands, "find_spec", lambda _: None)
    assert not commands.may_use_gpu("montecarlo", 1)


@pytest.mark.parametrize(("there", "due"), [("cpu", ""), ("gpu", "rvjax: units on the H100\n")])
def test_a_command_says_where_units_are_if_there_is_a_choice(monkeypatch, capsys, there, due):
    monkeypatch.setattr(jax, "local_devices", lambda: [SimpleNamespace(platform=there)])
    commands.tell("the H100")
    assert capsys.readouterr().err == due
