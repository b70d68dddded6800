"""The proof that a law, or a kind of requirement, has one place: both are defined here, and every door takes them.

Oracle: the fake law is a cosine arch whose quantile has no closed form but whose map here is h sin(z/2) about the
middle: mean 0 and variance h^2 (1 - exp(-1/2))/2 for standard normal z. The fake requirement asks for a small sd.
"""

import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax.population.tolerance import DISTRIBUTIONS, Distribution
from rvjax.records import field, record
from rvjax.study.goals import parse_requirements
from rvjax.study.tolerances import parse_tolerance
from rvjax.tolerances import (
    ReciprocalPower,
    Requirement,
    Tolerance,
    allocate,
    load,
    monte_carlo,
    rss,
    sample,
    save,
    worst_case,
)
from rvjax.tolerances.limits import KINDS, Limits
from rvjax.tolerances.requirements import CpkAtLeast, MeanWithin
from rvjax.units import um
from tests.oracles.responses import Linear


@record
class Arch(Distribution):
    """m + weight h sin(z/2)."""

    name = "arch"
    weight: Any = field("-", "a weight", default=1.0, sign="positive")

    def deviate(self, tolerance, z):
        return tolerance.middle + self.weight * tolerance.half_width * jnp.sin(z / 2)

    def moments(self, tolerance):
        h = self.weight * float(tolerance.half_width)  # E sin^2(z/2) = (1 - e^(-1/2))/2, E sin^4 from cos z, cos 2z
        fourth = (3 - 4 * math.exp(-0.5) + math.exp(-2)) / 8
        return float(tolerance.middle), h**2 * (1 - math.exp(-0.5)) / 2, 0.0, h**4 * fourth


@dataclass(frozen=True, kw_only=True)
class SdBelow(Limits):
    """The standard deviation at most `sd`."""

    of_units = False
    goal = "sd"
    sd: float = 1.0

    def learned(self, values):
        return np.nanstd(values, ddof=1) - self.sd

    def pull(self, values):
        spread = values - np.nanmean(values)
        return np.arange(len(values)), spread / np.nanstd(values, ddof=1) / len(values)

    def figure(self, sampled):
        return sampled.sd()

    def holds(self, estimate):
        return estimate.upper <= self.sd

    def shown(self, estimate, sd, deviate):
        return estimate.value + deviate * estimate.error - self.sd

    def text(self):
        return f"sd <= {self.sd:g}"


@pytest.fixture(scope="module", autouse=True)
def _registers():
    """Other tests do not know them."""
    yield
    DISTRIBUTIONS.pop("arch", None)
    KINDS.remove(SdBelow)


ARCH = Tolerance(-1.0, 3.0, distribution="arch", weight=0.5)
PAIR = {"a": ARCH, "b": Tolerance(-1.0, 1.0, distribution="arch")}


summed = Linear({"a": 1.0, "b": 2.0})


def test_a_law_has_one_place(tmp_path):
    share = (1 - math.exp(-0.5)) / 2
    variance = share * (1.0 + 4.0)
    linear = rss(summed, PAIR)
    assert (linear.mean, linear.sd**2) == pytest.approx((1.0, variance))
    found = monte_carlo(summed, PAIR, samples=50_000, seed=0, requirements=Requirement(upper=9.0))
    assert abs(found.sd.value - math.sqrt(variance)) < 4 * found.sd.error
    assert found.study["tolerances.a"] == "arch -1.0 .. 3.0, cp 1.0, weight 0.5"
    limits = worst_case(summed, PAIR)
    assert (limits.lower, limits.upper) == pytest.approx((-3.0, 5.0))
    save(PAIR, tmp_path / "a.json")
    again = load(tmp_path / "a.json")
    assert again["a"].law.weight == 0.5 and again["a"].distribution == "arch"
    assert sample(again, 3, seed=1)["a"] == sample(PAIR, 3, seed=1)["a"]
    read = parse_tolerance(dict(half_width="2 um", distribution="arch", weight=0.5), "m", "tolerances.x")
    assert (read.upper, read.law.weight) == (pytest.approx(2 * um), 0.5)
    scaled = Tolerance(-1.0, 3.0, distribution="arch").with_half_width(1.0)
    assert (scaled.lower, scaled.upper) == (0.0, 2.0)
    second = rss(summed, PAIR, correlation={("a", "b"): 0.5})
    # corr(sin z1/2, sin z2/2) = sinh(rho/4)/sinh(1/4)
    assert second.sd**2 == pytest.approx(variance + 4 * share * math.sinh(0.125) / math.sinh(0.25), rel=1e-9)


def test_a_kind_of_requirement_has_one_place():
    normal = {"a": Tolerance(-1.0, 1.0), "b": Tolerance(-1.0, 1.0)}
    asked = SdBelow(upper=1.0, sd=0.5)
    found = monte_carlo(summed, normal, samples=20_000, seed=0, requirements=asked)
    assert not found.verdicts.met and found.verdicts.wanted == "sd <= 0.5" and found.yield_ is None
    assert abs(found.verdicts.estimate.value - math.sqrt(5) / 3) < 4 * found.verdicts.estimate.error
    cost = ReciprocalPower(finest=0.01, coarsest=9.0, reference=1.0)
    best = allocate(summed, normal, asked, costs={"a": cost, "b": cost}, samples=4096, certificate_samples=50_000)
    a, b = best.half_widths.values()
    # Lagrange: t_a = 4^(1/3) t_b at t_a^2 + 4 t_b^2 = (3 sd)^2; slopes of 4096 units to 2.2 %, certified sd to 1 %.
    assert best.status == "OPTIMAL" and a / b == pytest.approx(4 ** (1 / 3), rel=0.04)
    assert math.hypot(a, 2 * b) == pytest.approx(1.5, rel=0.02)
    outputs = {"te": type("Output", (), {"unit": "rad"})}
    read = parse_requirements({"te": dict(upper="1 arcmin", sd=0.1)}, outputs)[0]["te"]
    assert isinstance(read, SdBelow) and read.sd == 0.1


def test_study_files_know_every_kind():
    outputs = {"te": type("Output", (), {"unit": "rad"})}
    one = lambda **entry: parse_requirements({"te": entry}, outputs)[0]["te"]  # noqa: E731
    assert one(upper="1 rad") == Requirement(upper=1.0, target=0.9973)
    assert one(upper="1 rad", cpk=1.5) == CpkAtLeast(upper=1.0, cpk=1.5)
    assert one(mean_lower="-1 rad", mean_upper="2 rad") == MeanWithin(lower=-1.0, upper=2.0)
    for entry, message in [
        (dict(target=0.9), "requirement.te: give upper or lower in rad"),
        (dict(upper="1 rad", mean_upper="1 rad"), "requirement.te.mean_upper = '1 rad': must not be given with upper"),
        (dict(upper="1 rad", target=0.9, cpk=1.0), "requirement.te.cpk = 1.0: must not be given with upper, target"),
        (dict(upper="1 rad", cpl=1.0), "unknown key requirement.te.cpl"),
        (dict(upper="1 rad", cpk="1"), "requirement.te.cpk = '1': must be a plain finite number"),
        (dict(upper="1 rad", cpk=0.0), "requirement.te: CpkAtLeast.cpk = 0"),
    ]:
        with pytest.raises(ValueError, match=message):
            one(**entry)
