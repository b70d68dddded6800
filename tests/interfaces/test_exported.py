"""Traced programs that the command line keeps: found again, traced again when anything differs, never in the way."""

import functools
import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax._jax import exported, programs
from rvjax.measured import Conditions
from rvjax.records import Record, field, record, text
from rvjax.response import per_response
from rvjax.response.response import Compiled

TRACED = []  # of the function below


@record
class Power(Record):
    """x -> size x^number."""

    size: object = field("-", "factor", shape=(3,))
    number: int = text("exponent")

    def __call__(self, x):
        return self.size * x**self.number


@record
class Found(Record):
    """A result that is a record."""

    value: object = field("-", "value")
    twice: object = field("-", "value")


def computed(response, x, *, names):
    TRACED.append(names)
    y = response(x)
    return {name: y for name in names}, Found(y, 2 * y)


@pytest.fixture
def folder(kept_programs):
    """Programs are kept in an empty folder; nothing was traced."""
    TRACED.clear()
    return kept_programs


def another_process():
    """The same function, in which nothing has been traced yet."""
    return Compiled(computed, ("names",))


def test_the_next_process_does_not_trace(folder):
    x = np.linspace(0.1, 2.0, 7)
    given = Power(3.0, 2), x
    plain = jax.jit(computed, static_argnames="names")(*given, names=("b", "a"))
    TRACED.clear()
    first = another_process()(*given, names=("b", "a"))
    assert len(TRACED) == 1
    later = another_process()(*given, names=("b", "a"))
    other_number = another_process()(Power(5.0, 2), x, names=("b", "a"))
    assert len(TRACED) == 1 and len(list(folder.iterdir())) == 1
    for found in (first, later):
        assert jax.tree.structure(found) == jax.tree.structure(plain)
        jax.tree.map(np.testing.assert_array_equal, found, plain)
    assert isinstance(later[1], Found)
    np.testing.assert_allclose(other_number[1].twice, 10 * x**2)


def test_what_differs_is_traced(folder, monkeypatch):
    x = np.ones(3)
    asked = [
        ((Power(3.0, 2), x), ("a",)),
        ((Power(3.0, 3), x), ("a",)),  # text of the response
        ((Power(3.0, 2), np.ones(4)), ("a",)),
        ((Power(3.0, 2), x.astype(np.float32)), ("a",)),
        ((Power(jnp.ones(3), 2), x), ("a",)),
        ((Power(3.0, 2), x), ("b",)),
    ]
    for count, (given, names) in enumerate(asked, 1):
        for _ in range(2):
            found = another_process()(*given, names=names)
            assert list(found[0]) == list(names)
            expected = given[0](given[1])
            np.testing.assert_array_equal(found[1].value, expected)
            assert found[1].value.dtype == expected.dtype
        assert len(TRACED) == count == len(list(folder.iterdir()))
    monkeypatch.setattr(exported, "_source", lambda: "another version")
    another_process()(*asked[0][0], names=("a",))
    assert len(TRACED) == len(asked) + 1


def test_a_program_of_another_source_is_traced(monkeypatch):
    """A program may hold formulas of any package: each of them is part of the key."""
    digest, read = exported._source.__wrapped__, Path.read_bytes
    before, root = digest(), Path(exported.__file__).parents[1]
    for changed in (root / "life" / "rating.py", root / "_jax" / "kernels.py", root / "units.py"):
        other = lambda path, changed=changed: read(path) + b"#" * (path == changed)  # noqa: E731
        monkeypatch.setattr(Path, "read_bytes", other)
        assert digest() != before, changed
    monkeypatch.setattr(Path, "read_bytes", read)
    assert digest() == before


@pytest.mark.parametrize("content", [b"", b"not a program", None])
def test_a_file_that_does_not_load_is_traced_again(folder, content, capsys):
    given = Power(3.0, 2), np.ones(3)
    another_process()(*given, names=("a",))
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] if content is None else content)
    for _ in range(2):
        np.testing.assert_array_equal(another_process()(*given, names=("a",))[0]["a"], 3.0)
    assert len(TRACED) == 2 and path.stat().st_size > 0.9 * len(whole)
    assert capsys.readouterr() == ("", "")


def test_only_the_command_line_keeps_and_only_what_has_a_name(folder, monkeypatch):
    def plain(x):
        return 3 * x

    np.testing.assert_array_equal(another_process()(plain, np.ones(3), names=("a",))[0]["a"], 3.0)
    named = per_response(static=("law",))(lambda response, x, *, law: law(response(x)))
    np.testing.assert_array_equal(named(Power(3.0, 2), np.ones(3), law=lambda y: -y), -3.0)
    inner = another_process()
    assert jax.grad(lambda size: inner(Power(size, 2), jnp.ones(3), names=("a",))[0]["a"].sum())(3.0) == 3.0
    assert not list(folder.iterdir())
    monkeypatch.setattr(programs, "_folder", [])
    another_process()(Power(3.0, 2), np.ones(3), names=("a",))
    assert not list(folder.iterdir())


def double(x):
    return 2 * x


@record
class Through(Record):
    """x -> function(size x)."""

    size: object = field("-", "factor", shape=(3,))
    function: object = text("of the product")

    def __call__(self, x):
        return self.function(self.size * x)


def test_functions_count_by_their_name_in_a_module(folder):
    """A model may hold functions: those of a module are found again, others, also of the same name, are not kept."""
    other = type(double)(double.__code__.replace(co_consts=(None, 5)), {}, "double")
    other.__module__, other.__qualname__ = double.__module__, "double"
    for function, kept, factor in (
        (double, 1, 2), (double, 1, 2), (other, 1, 5), (lambda x: 7 * x, 1, 7),
        (functools.partial(scaled, factor=3), 2, 3), (functools.partial(scaled, factor=4), 3, 4), (jnp.sin, 4, None),
    ):  # fmt: skip
        found = another_process()(Through(1.0, function), np.ones(3), names=("a",))[0]["a"]
        np.testing.assert_allclose(found, np.sin(1.0) if factor is None else factor)
        assert len(list(folder.iterdir())) == kept


def test_lambdas_of_the_package_count_by_their_code(folder, monkeypatch):
    """Models hold such functions; the digest of the source says what else they read."""
    triple, five = (lambda x: 3 * x), (lambda x: 5 * x)
    size = 7
    for function in (triple, five, within := lambda x: size * x):
        monkeypatch.setattr(function, "__module__", "rvjax.somewhere")
    for function, kept, factor in ((triple, 1, 3), (triple, 1, 3), (five, 2, 5), (within, 2, 7)):
        found = another_process()(Through(1.0, function), np.ones(3), names=("a",))[0]["a"]
        np.testing.assert_allclose(found, factor)
        assert len(list(folder.iterdir())) == kept


def scaled(x, *, factor):
    return factor * x


def test_studies_and_bench_models_have_names():
    """What the commands compile; only numbers and names are in the text, in any process."""
    from rvjax import study
    from rvjax.study import bench

    whole = study.load("rv-40e-whole", solve=False)
    curve = bench.curve_model("four_bar", whole.design, whole.conditions, (Conditions(torque=412.0),), (40,), (), ())
    for model in (whole.response(), study.load("corr", solve=False).response(), curve):
        spelled = exported._spelled(jax.tree.structure(model))
        assert type(model).__qualname__ in spelled and " at 0x" not in spelled


def factors(design, x):
    return jnp.linalg.eigh(x)[0], jnp.linalg.svd(x)[1], jnp.linalg.solve(x, x), jnp.linalg.qr(x)[0]


LAPACK = """
import sys
from pathlib import Path
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
from rvjax._jax import programs
programs._folder[:] = [Path(sys.argv[1])]
import test_exported
print(*test_exported.singular_values())
"""


def singular_values():
    found = per_response()(factors)(Power(3.0, 2), np.diag([1.0, 2.0, 3.0]))
    return [*map(float, found[0]), *map(float, found[1])]


def test_linear_algebra_of_another_process(folder):
    """JAX loads LAPACK while it lowers; without that a program from a file ends in a segmentation fault."""
    assert singular_values() == pytest.approx([1, 2, 3, 3, 2, 1])
    (kept,) = folder.iterdir()
    run = [sys.executable, "-c", LAPACK, str(folder)]
    own = os.environ | {"PYTHONPATH": str(Path(__file__).parent)}
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, env=own, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stderr
    assert [float(x) for x in done.stdout.split()] == pytest.approx([1, 2, 3, 3, 2, 1])
    assert list(folder.iterdir()) == [kept]


def test_options_of_the_compiler_are_given_to_a_kept_program(folder, traced_option):
    options, count = traced_option
    for runs in (1, 2):  # traced, and found
        found = Compiled(computed, ("names",), options)(Power(3.0, 2), np.ones(3), names=("a",))[0]["a"]
        np.testing.assert_array_equal(found, 3.0)
        assert len(TRACED) == 1 and count("*") > runs  # one is the trial of the options


def test_keep_says_where(monkeypatch, folder):
    assert programs.kept_folder() == folder
    monkeypatch.setenv(programs.OFF, "0")
    assert programs.keep("1") is None and programs.kept_folder() is None


@record
class Weighted(Record):
    """x -> sum of weights x^k, times size."""

    weights: object = field("-", "of the powers", shape=(3,))
    size: object = field("-", "factor")
    long: object = field("-", "added element by element", shape=(70,))

    def __call__(self, x):
        return self.size * (self.weights[0] + self.weights[1] * x + self.weights[2] * x**2) + jnp.sum(self.long)


def test_numbers_of_several_fields_arrive_each_in_its_place(folder):
    """Fields of three numbers, of one and of many: the program of one record serves another."""
    x = jnp.linspace(0.0, 2.0, 5)
    another_process()(Weighted(np.ones(3), 1.0, np.zeros(70)), x, names=("a",))
    long = np.arange(70.0)
    found = another_process()(Weighted(np.array([2.0, 3.0, 5.0]), 7.0, long), x, names=("a",))[0]["a"]
    assert len(TRACED) == 1
    np.testing.assert_allclose(found, 7.0 * (2.0 + 3.0 * x + 5.0 * x**2) + long.sum(), rtol=1e-14)


SHARED = """
import sys
from pathlib import Path
import jax, numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from rvjax._jax import programs
from test_exported import Power, another_process
programs._folder[:] = [Path(sys.argv[1])]
mesh = Mesh(np.array(jax.devices()), ("units",))
x = jax.device_put(np.arange(4.0)[:, None], NamedSharding(mesh, PartitionSpec("units")))
process, written = another_process(), np.full(3, 3.0)
for size in (3.0, 3.0, 5.0, 3.0):
    print(*process(Power(size, 2), x, names=("a",))[0]["a"][:, 0])
for size in (3.0, 5.0):
    written[:] = size
    print(*process(Power(written, 2), x, names=("a",))[0]["a"][:, 0])
"""


@pytest.mark.parametrize("devices", [1, 2])
def test_numbers_that_change_between_calls_arrive(folder, devices):
    """They stay on the devices while they are the same; an array that is written to in place does not."""
    run = [sys.executable, "-c", SHARED, str(folder)]
    own = os.environ | {"PYTHONPATH": str(Path(__file__).parent), "JAX_NUM_CPU_DEVICES": str(devices)}
    done = subprocess.run(run, capture_output=True, text=True, timeout=120, env=own, cwd=Path(__file__).parents[2])
    assert done.returncode == 0, done.stderr
    rows = [[float(x) for x in line.split()] for line in done.stdout.splitlines()]
    assert rows == [[size * x**2 for x in range(4)] for size in (3, 3, 5, 3, 3, 5)]
    assert len(list(folder.iterdir())) == 2  # for a number and for an array


def test_a_number_and_an_array_of_one_number_share_a_program(folder):
    """Records that were read from a file hold arrays."""
    x, found = jnp.linspace(0.0, 2.0, 5), []
    for size in (3.0, np.float64(3.0), np.array(3.0)):
        found.append(another_process()(Weighted(np.ones(3), size, np.zeros(70)), x, names=("a",))[0]["a"])
    assert len(TRACED) == 1 and len(list(folder.iterdir())) == 1
    np.testing.assert_array_equal(found[1], found[0])
    np.testing.assert_array_equal(found[2], found[0])
