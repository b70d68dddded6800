"""Programs that the command line keeps: where, when not, and how many."""

import os
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from rvjax._jax import programs


@pytest.fixture
def none_kept(monkeypatch, tmp_path):
    """A user with an empty cache folder; JAX as it was afterwards."""
    names = ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    before = {name: jax.config.values[name] for name in names}
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(sys, "platform", "linux")
    jax.config.update("jax_compilation_cache_dir", None)
    yield tmp_path
    for name, value in before.items():
        jax.config.update(name, value)


def test_programs_are_kept_in_the_cache_folder_of_the_user(none_kept):
    folder = programs.keep("1.2.3")
    assert folder.is_dir() and folder.parent == none_kept / "rvjax" and "1.2.3" in folder.name
    assert jax.config.values["jax_compilation_cache_dir"] == str(folder)


def test_nothing_is_kept_where_it_is_switched_off_or_named_elsewhere_or_cannot_be_written(none_kept, monkeypatch):
    monkeypatch.setenv(programs.OFF, "0")
    assert programs.keep("1") is None
    monkeypatch.delenv(programs.OFF)
    (none_kept / "rvjax").write_text("a file where the folder should be")
    assert programs.keep("1") is None and jax.config.values["jax_compilation_cache_dir"] is None
    jax.config.update("jax_compilation_cache_dir", "of the user")
    assert programs.keep("1") is None and jax.config.values["jax_compilation_cache_dir"] == "of the user"


def test_those_used_longest_ago_go_first(tmp_path):
    for age, name in enumerate(("new", "old", "oldest")):
        (tmp_path / name).write_bytes(b"x" * 100)
        os.utime(tmp_path / name, (1e9 - age, 1e9 - age))
    programs.prune(tmp_path, 250)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["new", "old"]
    programs.prune(tmp_path, 0)
    assert not list(tmp_path.iterdir())


def test_importing_the_package_loads_no_jax():
    """What the command line sets must be set before; `rvjax --help` answers at once. scipy.stats takes a second."""
    code = "import sys, rvjax, rvjax.cli; assert 'jax' not in sys.modules\n"
    code += "import rvjax.study; assert not {'scipy.stats', 'optax'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])
    assert "jax" in sys.modules  # this is its name where it is loaded


def test_a_function_has_its_compiler_options_alone_and_none_within_another_program(traced_option):
    options, count = traced_option

    @programs.quick(0, options=options)
    def power(number, x):
        return x**number

    assert count("power") == 0  # XLA is started by the first call
    assert power(2, 3.0) == 9.0
    assert count("power") == 1
    # Within another program XLA would raise an error for options of a part.
    assert jax.jit(lambda x: power(2, x))(3.0) == 9.0
    assert jax.jit(lambda x: x * power(2, 3.0))(2.0) == 18.0  # no argument of `power` is traced
    assert jax.grad(lambda x: power(3, x))(2.0) == 12.0
    assert power(2, 4.0) == 16.0
    assert count("power") == 1


def test_a_batch_of_a_quick_function_is_compiled_with_the_quick_options(monkeypatch):
    """`jax.vmap` without a program of its own: options of one case (`ONCE`) would make a batch slow."""
    seen, real = [], programs.understood
    monkeypatch.setattr(programs, "understood", lambda options: seen.append(options) or real(options))
    power = programs.quick(0, options=programs.ONCE)(lambda number, x: x**number)
    assert jax.vmap(lambda x: power(2, x))(jnp.arange(3.0)).tolist() == [0.0, 1.0, 4.0]
    assert seen == [programs.QUICK]
    assert jax.vmap(jax.grad(lambda x: power(3, x)))(jnp.arange(3.0)).tolist() == [0.0, 3.0, 12.0]
    assert jax.jit(jax.vmap(lambda x: power(2, x)))(jnp.arange(3.0)).tolist() == [0.0, 1.0, 4.0]
    assert seen == [programs.QUICK]
    assert power(2, 3.0) == 9.0 and seen == [programs.QUICK, programs.ONCE]


def test_a_quick_function_is_compiled_with_the_quick_options():
    """Its first call looks the default options up; JAX does not show those of a compiled function."""
    programs.understood.cache_clear()
    square = programs.quick()(lambda x: x * x)
    assert square(3.0) == 9.0 and programs.understood.cache_info().misses == 1
    programs.understood(programs.QUICK)
    assert programs.understood.cache_info().misses == 1
