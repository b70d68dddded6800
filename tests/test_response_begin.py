"""Programs that a thread compiles while the caller goes on.

Oracle: the same function called at once: the same bits.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import compile_cache
from rvjax.records import Record, Scalar, field, record
from rvjax.response import per_response


@record
class Line(Record):
    slope: Scalar = field("-", "of a line")

    def __call__(self, errors):
        return self.slope * errors


@per_response(static=("power",))
def powers(response, x, *, power):
    return {"y": response(x) ** power}


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(compile_cache, "_folder", [tmp_path])
    monkeypatch.setattr(powers, "_flat", {})
    return tmp_path


def test_a_begun_program_serves_the_call(kept):
    x = jnp.arange(4.0)
    at_once = np.asarray(jax.jit(lambda x: (3.0 * x) ** 2)(x))
    powers.begin(Line(slope=3.0), x, power=2)
    (program,) = powers._flat.values()
    program.call.join()
    assert program.call._compiled is not None
    np.testing.assert_array_equal(powers(Line(slope=3.0), x, power=2)["y"], at_once)
    powers.begin(Line(slope=4.0), x, power=2)  # the same program, which is not compiled again
    assert list(powers._flat.values()) == [program]


def test_a_program_that_does_not_compile_says_so_where_it_is_called(kept, monkeypatch):
    def fails(lowered, *args, **options):
        raise RuntimeError("no")

    monkeypatch.setattr(jax.stages.Lowered, "compile", fails)
    powers.begin(Line(slope=3.0), jnp.arange(5.0), power=3)
    monkeypatch.undo()
    (program,) = powers._flat.values() if powers._flat else [None]
    assert program is None or program.call._compiled is None
