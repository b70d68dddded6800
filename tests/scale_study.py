"""A small study of every kind of unit for the tests at full scale, and ways to compare two runs of it."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import study
from rvjax.commands.budget.effects import curves_of
from rvjax.population import Population, root_key
from rvjax.response import numbers_of
from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance, monte_carlo

STACK = {name: Tolerance.symmetric(size) for name, size in dict(a=3.0, b=2.0, c=1.0).items()}
LIMITS = {"y": Requirement(upper=3.0), "z": Requirement(lower=-2.0, upper=2.0)}


def response(e):
    """Smooth, kinked, and without a value now and then for two reasons."""
    y = e["a"] + 0.3 * e["b"] ** 2
    status = jnp.where(e["c"] > 0.9, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED))
    return Outcome({"y": jnp.where(e["b"] < -1.9, jnp.nan, y), "z": jnp.abs(e["b"]) - e["c"]}, status)


def smooth(e):
    return e["a"] + 0.3 * e["b"] ** 2 - 0.1 * e["a"] * e["c"]


def first(e):
    return e["a"]


def run(samples=9000, *, respond=response, **options):
    defaults = dict(seed=3, chunk=1000, requirements=LIMITS if respond is response else None)
    return monte_carlo(respond, STACK, samples=samples, **(defaults | options))


def bits(statistics):
    """Every figure as text that changes with its last bit; what was asked is compared apart."""
    kept = jax.tree.map(lambda values: values.tobytes(), statistics.values)
    return repr(dataclasses.replace(statistics, values=kept, study={}))


def same_to_roundoff(one, two):
    assert (one.samples, one.failures, one.examples) == (two.samples, two.failures, two.examples)
    assert one.joint_yield == two.joint_yield and one.yield_ == two.yield_
    for name in one.mean:
        for figure in ("mean", "sd"):
            for end in ("value", "error"):
                a, b = (getattr(getattr(s, figure)[name], end) for s in (one, two))
                assert a == pytest.approx(b, rel=1e-12, abs=1e-14)
        for p in one.quantiles:
            assert one.quantiles[p][name].value == pytest.approx(two.quantiles[p][name].value, rel=1e-9)


def curves():
    """Angles and curves of 300 units of the four-bar model: a full call and a part of one."""
    asked = study.load("rv-40e", solve=False)
    population = Population.of(asked.tolerances)
    z = numbers_of(population, root_key(2), np.arange(300))
    return curves_of(asked.curve, asked.design, asked.conditions, population, z)
