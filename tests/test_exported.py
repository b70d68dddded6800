"""Traced programs that the command line keeps: found again, traced again when anything differs, never in the way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import compile_cache, exported
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
def folder(monkeypatch, tmp_path):
    """As if the command line kept its programs here."""
    monkeypatch.setattr(compile_cache, "_folder", [tmp_path])
    TRACED.clear()
    return tmp_path


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
    monkeypatch.setattr(compile_cache, "_folder", [])
    another_process()(Power(3.0, 2), np.ones(3), names=("a",))
    assert not list(folder.iterdir())


def test_options_of_the_compiler_are_given_to_a_kept_program(folder, traced_option):
    options, count = traced_option
    for runs in (1, 2):  # traced, and found
        found = Compiled(computed, ("names",), options)(Power(3.0, 2), np.ones(3), names=("a",))[0]["a"]
        np.testing.assert_array_equal(found, 3.0)
        assert len(TRACED) == 1 and count("*") > runs  # one is the trial of the options


def test_keep_says_where(monkeypatch, folder):
    assert compile_cache.kept_folder() == folder
    monkeypatch.setenv(compile_cache.OFF, "0")
    assert compile_cache.keep("1") is None and compile_cache.kept_folder() is None
