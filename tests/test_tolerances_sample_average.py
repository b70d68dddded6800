"""The sample that an allocation learns from: what failed units do to its margins; and what a certificate holds for.

Oracle: the share of units that fail, Phi(-1.5) = 6.7 %, and the quantiles of the normal law among the others.
"""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from rvjax.population.estimates import Estimate
from rvjax.population.population import Population
from rvjax.tolerances import Requirement, Tolerance
from rvjax.tolerances.allocation.certificate import Certifier
from rvjax.tolerances.optimum.sample_average import Training

SAMPLES = 4096


def margins(target, joint_target):
    """Of the units of N(0, 1/3), those above 1/2 without value, to an upper limit of 2: its own and the joint one."""
    response = lambda e: {"y": jnp.where(e["x"] > 0.5, jnp.nan, e["x"])}  # noqa: E731
    required = {"y": Requirement(upper=2.0, target=target)}
    given = Population.of({"x": Tolerance.symmetric(1.0)})
    return Training(response, given, ("x",), required, joint_target, SAMPLES, 0).margins(np.ones(1))


def test_failed_units_are_beyond_every_limit():
    """More of them than a target leaves out, and there is no quantile; fewer, and they are the last units of all."""
    assert np.array_equal(margins(0.95, 0.95), [np.inf, np.inf])
    own, joint = margins(0.9, 0.9)
    # A share p of 4096 units is off by sqrt(p (1 - p) / n) = 0.005, their quantile by that over the density: 0.01.
    quantile = stats.norm.ppf(0.9) / 3
    assert own == pytest.approx(quantile - 2.0, abs=0.03)
    assert joint == pytest.approx((quantile - 2.0) / 2.0, abs=0.015)  # in parts of the way to the limit


@pytest.mark.parametrize(("lower", "holds"), [(0.9899, False), (0.99, True)])
def test_a_certificate_counts_a_joint_yield_by_its_worse_end(lower, holds):
    met = {"y": SimpleNamespace(met=True)}
    statistics = SimpleNamespace(verdicts=met, joint_yield=Estimate(0.992, 0.001, lower, 0.994))
    assert Certifier(None, 0.99).holds(statistics) is holds
    assert Certifier(None, None).holds(statistics)
    assert not Certifier(None, None).holds(
        SimpleNamespace(verdicts={"y": SimpleNamespace(met=False)}, joint_yield=None)
    )


def test_every_certificate_has_units_of_its_own():
    """A run that tells its seed: no certificate sees the units of the search, or of another certificate."""

    @dataclasses.dataclass(frozen=True)
    class Seen:
        seed: int
        verdicts: dict

    @dataclasses.dataclass(frozen=True)
    class Told:
        seed: int
        population: object = None
        keep: bool = False

        def statistics(self):
            return Seen(self.seed, {})

    certifier = Certifier(Told(3), None)
    assert [certifier.draw(None).seed for _ in range(3)] == [4, 5, 6]
