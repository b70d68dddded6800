"""A response that is a record is an argument of its programs; a plain function is held for a while only.

Oracles: counts of compilations, weak references, and the memory of the process. A program of its own costs some
0.5 to 1.5 MB, so that 200 of them would be 100 MB or more; 64 MB of growth leaves room for the allocator alone.
"""

import gc
import weakref
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax._jax.programs import QUICK, understood
from rvjax.population.population import Population, drawn, root_key
from rvjax.records import Record, count, field, record
from rvjax.response import response as module
from rvjax.response.derivatives import pulled
from rvjax.response.response import PROGRAMS, per_response, respond
from rvjax.tolerances import (
    ReciprocalPower,
    Requirement,
    Tolerance,
    allocate,
    failure_probability,
    monte_carlo,
    rss,
    worst_case,
)
from rvjax.tolerances.batch.checkpoint import response_hash
from tests.oracles.programs import programs

PAIR = {"a": Tolerance(-1.0, 1.0), "b": Tolerance(-1.0, 2.0)}
POPULATION = Population.of(PAIR)
COMPILED = "/jax/core/compile/backend_compile_duration"


@record
class Lever(Record):
    """A cheap design that is its own response."""

    arm: Any = field("m", "length")
    table: Any = field("-", "weights", shape=("n",))
    power: int = count("of the second error")

    def __call__(self, e: Any) -> Any:
        """Arm times one error, and a power of the other."""
        return self.arm * e["a"] + jnp.sum(self.table) * e["b"] ** self.power


def lever(arm, power=1):
    return Lever(arm, np.array([arm / 2, arm / 2]), power)


def resident():
    """Memory of this process, MB."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 2**20


def test_a_record_computes_what_a_closure_does():
    inner = lever(3.0)
    plain = lambda e: inner(e)  # noqa: E731
    z = drawn(POPULATION, root_key(0), jnp.uint32(0), count=64)
    # Constants are folded into a program, arguments are not: a rounding or two.
    np.testing.assert_allclose(respond(inner, POPULATION, z)[0][""], respond(plain, POPULATION, z)[0][""], rtol=1e-14)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_two_hundred_designs_share_one_program_and_none_is_kept():
    z = drawn(POPULATION, root_key(0), jnp.uint32(0), count=4)
    respond(lever(1.0), POPULATION, z)
    gc.collect()
    compiled, before, alive = programs(respond, lever(1.0)), resident(), []
    for k in range(200):
        design = lever(1.0 + k)
        values, _ = respond(design, POPULATION, z)
        if k % 2 == 0:
            alive += [weakref.ref(design), weakref.ref(design.table)]
    assert float(values[""][0]) == pytest.approx(float(design({k: v[0] for k, v in POPULATION.errors(z).items()})))
    del design, values
    gc.collect()
    assert programs(respond, lever(1.0)) == compiled
    assert not any(reference() is not None for reference in alive)
    assert resident() - before < 64
    respond(lever(1.0, power=2), POPULATION, z)  # a count is part of the program
    assert programs(respond, lever(1.0)) == compiled + 1


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_plain_functions_are_released(monkeypatch):
    """The same with an eighth of the programs that are kept."""
    monkeypatch.setattr(module, "PROGRAMS", PROGRAMS // 8)
    added = per_response()(lambda response, x: response(x))  # a program of one addition: 40 compile in a second
    alive, settled = [], 0.0
    for k in range(40):
        if k == 8:
            settled = resident()
        table = np.full(1000, float(k))
        alive.append(weakref.ref(table))
        added(lambda x, table=table: x + table[0], 1.0)
    del table
    gc.collect()
    assert sum(reference() is not None for reference in alive) == PROGRAMS // 8
    assert resident() - settled < 5  # 32 more functions; what is kept of each would be 0.2 MB or more
    z = drawn(POPULATION, root_key(0), jnp.uint32(0), count=4)
    last = lambda e: e["a"]  # noqa: E731
    respond(last, POPULATION, z)
    respond(last, POPULATION, z)
    assert programs(respond, last) == 1


def test_every_question_serves_the_next_design_with_the_same_programs(compiled):
    limits, cost = Requirement(upper=40.0, target=0.99), ReciprocalPower(finest=0.1, coarsest=9.0, reference=1.0)
    priced = dict(costs={"a": cost, "b": cost}, samples=512, certificate_samples=1000, max_steps=2)

    def ask(design):
        monte_carlo(design, PAIR, samples=100, seed=0, requirements=limits)
        rss(design, PAIR)
        worst_case(design, PAIR)
        failure_probability(design, PAIR, Requirement(upper=9.0 * design.arm), samples=100, seed=0)
        return allocate(design, PAIR, limits, **priced)

    ask(lever(3.0))
    assert COMPILED in compiled
    before = [programs(item, lever(1.0)) for item in (respond, pulled)]
    compiled.clear()
    ask(lever(4.0))
    assert COMPILED not in compiled
    assert [programs(item, lever(1.0)) for item in (respond, pulled)] == before


def test_the_fingerprint_sees_the_numbers_of_a_record():
    of = lambda design: response_hash(design, POPULATION)  # noqa: E731
    assert of(lever(1.0)) == of(lever(1.0))
    assert len({of(lever(1.0)), of(lever(1.0 + 2e-16)), of(lever(1.0, 2)), of(lever(1.0).replace(arm=2.0))}) == 4


def test_a_response_has_its_own_compiler_options(traced_option):
    options, count = traced_option

    @record
    class Told(Lever):
        """A lever with options of the compiler."""

        compiler_options = options

    @per_response()
    def value_of_lever(response, errors):
        return response(errors)

    errors = {"a": 2.0, "b": 3.0}
    plain, told = lever(1.0, 2), Told(1.0, np.array([0.5, 0.5]), 2)
    assert value_of_lever(plain, errors) == 11.0 and count("value_of_lever") == 0
    assert value_of_lever(told, errors) == 11.0 and count("value_of_lever") == 1
    assert jax.jit(lambda a: value_of_lever(told, errors | {"a": a}))(2.0) == 11.0  # there the outer options count
    assert jax.jit(lambda a: a / 2 * value_of_lever(told, errors))(2.0) == 11.0
    assert count("value_of_lever") == 1


def test_an_option_that_xla_lacks_is_dropped():
    made_up, everywhere = ("xla_cpu_made_up", True), ("xla_llvm_disable_expensive_passes", True)
    assert understood((made_up,)) is None
    assert understood((made_up, everywhere)) == dict([everywhere])
    left = () if understood(QUICK[:1]) else QUICK[:1]  # XLA lost it with JAX 0.10
    assert understood(QUICK) == dict(option for option in QUICK if option not in left)
    assert not left or tuple(map(int, jax.__version__.split(".")[:2])) >= (0, 10)
