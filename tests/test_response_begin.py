"""Programs that other threads compile before they are called.

Oracle: the same function compiled by the call itself.
"""

from concurrent import futures

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax._jax import compile_cache
from rvjax.records import Record, Scalar, field, record
from rvjax.response import per_response


@record
class Line(Record):
    """x -> slope x."""

    slope: Scalar = field("-", "of a line")

    def __call__(self, errors):
        return self.slope * errors


def powers(response, x, *, power):
    return {"y": jnp.sin(response(x)) ** power}


def at_rest(program):
    """Wait until all that has begun is compiled."""
    futures.wait([one.begun for one in program._flat.values() if one.begun is not None])


def test_a_call_finds_the_program_that_was_begun(kept_programs, compiled):
    x, program = jnp.linspace(0.1, 2.0, 37), per_response(static=("power",))(powers)
    expected = jax.jit(lambda x: jnp.sin(3.0 * x) ** 2)(x)
    program.begin(Line(slope=1.0), jnp.zeros(37), power=2)
    at_rest(program)
    compile_cache.inside()  # an operation, which is compiled once
    compiled.clear()
    found = program(Line(slope=3.0), x, power=2)["y"]
    assert not any("backend_compile" in event for event in compiled)
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    program.begin(Line(slope=4.0), x, power=2)  # compiled already
    at_rest(program)
    assert not any("backend_compile" in event for event in compiled)
    np.testing.assert_allclose(program(Line(slope=4.0), x, power=2)["y"], jnp.sin(4.0 * x) ** 2, rtol=1e-14)


def test_nothing_begins_where_no_programs_are_kept(compiled):
    program = per_response(static=("power",))(powers)
    compiled.clear()
    program.begin(Line(slope=1.0), np.zeros(41), power=2)
    assert not program._flat and not compiled


def test_an_error_of_a_begun_program_is_raised_by_the_call(kept_programs):
    @per_response()
    def too_large(response, x):
        return jnp.sum(jnp.sort(response(x)[0] + jnp.arange(2.0**46)))

    x = jnp.ones(3)
    too_large.begin(Line(slope=1.0), x)
    at_rest(too_large)
    with pytest.raises(jax.errors.JaxRuntimeError):
        jax.block_until_ready(too_large(Line(slope=1.0), x))
