"""Sampling and Monte Carlo.

Oracles: closed-form moments, quantiles and yields; NumPy on the kept values; SciPy's binomial law. Sampled
figures must lie within 4 of their own standard errors (the seeds are fixed); counts of different
chunks are equal, moments agree to 1e-12.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize, stats

import rvjax
from oracles.known_optima import many_fields
from oracles.programs import programs
from oracles.responses import Linear
from rvjax.population import Population, root_key
from rvjax.population.estimates import wilson
from rvjax.response import BLOCK, numbers_of
from rvjax.response.response import respond
from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance, for_design, monte_carlo, sample
from rvjax.units import mm, um

STACK = dict(a=Tolerance.symmetric(12 * um), b=Tolerance.symmetric(9 * um), c=Tolerance.symmetric(6 * um))
LIMITS = Requirement(lower=-30 * um, upper=30 * um)


linear = Linear(dict(a=3.0, b=-2.0, c=1.0))


def pair(e):
    return {"sum": e["a"] + e["b"] + e["c"], "largest": jnp.maximum(e["a"], e["b"])}


def first(e):
    return e["a"]


def three(e):
    return jnp.ones(3)


def within(estimate, expected, errors=4.0):
    assert abs(estimate.value - expected) <= errors * estimate.error
    assert estimate.lower <= estimate.value <= estimate.upper


def test_normal_stack_meets_its_closed_form():
    found = monte_carlo(linear, STACK, samples=400_000, seed=1, requirements=LIMITS)
    sd = math.sqrt(12**2 + 6**2 + 2**2) * um
    within(found.mean, 0.0)
    within(found.sd, sd)
    assert found.sd.error == pytest.approx(sd / math.sqrt(2 * 400_000), rel=0.02)  # of a normal law
    within(found.quantiles[0.99865], 3 * sd)
    within(found.quantiles[0.00135], -3 * sd)
    within(found.yield_, 2 * stats.norm.cdf(30 * um / sd) - 1)
    assert found.yield_.value == pytest.approx(0.97301, abs=1e-3)
    assert found.ppm.value == pytest.approx(1e6 * (1 - found.yield_.value))
    assert found.ppm.lower == pytest.approx(1e6 * (1 - found.yield_.upper))
    assert found.cp == pytest.approx(60 * um / (6 * found.sd.value))
    assert found.cpk == pytest.approx((30 * um - abs(found.mean.value)) / (3 * found.sd.value))
    assert found.joint_yield == found.yield_
    assert (found.failed, found.failures, found.worst_index, found.values) == (0, {}, None, None)


def test_error_of_the_sd_holds_for_a_law_that_is_not_normal():
    uniform = jax.tree.map(
        lambda t: t.replace(distribution="uniform"), STACK, is_leaf=lambda t: isinstance(t, Tolerance)
    )
    sds = [monte_carlo(first, uniform, samples=2000, seed=s).sd for s in range(40)]
    # Uniform: var(s^2) = (m4 - m2^2)/n, m4 = 9/5 m2^2, so the error is s sqrt(0.8/n)/2, not s/sqrt(2 n).
    assert np.mean([sd.error for sd in sds]) == pytest.approx(
        12 * um / math.sqrt(3) * math.sqrt(0.8 / 2000) / 2, rel=0.02
    )
    assert np.std([sd.value for sd in sds]) == pytest.approx(np.mean([sd.error for sd in sds]), rel=0.35)
    within(
        monte_carlo(linear, uniform, samples=100_000, seed=0).sd, math.sqrt(36**2 + 18**2 + 6**2) / math.sqrt(3) * um
    )


def test_rayleigh_vectors_and_magnitudes():
    tolerances = {
        "vector": Tolerance(0.0, 9 * um, distribution="rayleigh", shape=(2,)),
        "size": Tolerance(0.0, 9 * um, distribution="rayleigh"),
    }

    def response(e):
        radial, tangential = e["vector"][0], e["vector"][1]
        return {"length": jnp.hypot(radial, tangential), "radial": radial, "size": e["size"]}

    limits = {"length": Requirement(upper=9 * um), "size": Requirement(upper=9 * um)}
    found = monte_carlo(response, tolerances, samples=50_000, seed=3, requirements=limits)
    for name in ("length", "size"):
        within(found.mean[name], 3 * um * math.sqrt(math.pi / 2))
        within(found.sd[name], 3 * um * math.sqrt(2 - math.pi / 2))
        within(found.yield_[name], 1 - math.exp(-4.5))
    within(found.mean["radial"], 0.0)
    within(found.sd["radial"], 3 * um)
    assert found.yield_["radial"] is None
    assert math.isnan(found.cp["size"])  # one-sided


def test_batch_factor_correlates_the_elements_of_a_field():
    tolerances = {
        "x": Tolerance.symmetric(3.0, shape=(4,), batch=0.5),
        "v": Tolerance(0.0, 3.0, distribution="rayleigh", shape=(3, 2), batch=0.4),
    }

    def response(e):
        crossed = e["v"][0, 0] * e["v"][1, 1]
        return {"mean": jnp.mean(e["x"]), "one": e["x"][2], "radial": jnp.sum(e["v"][:, 0]), "cross": crossed}

    found = monte_carlo(response, tolerances, samples=50_000, seed=0)
    within(found.sd["mean"], math.sqrt((1 + 3 * 0.5) / 4))
    within(found.sd["one"], 1.0)
    within(found.sd["radial"], math.sqrt(3 + 6 * 0.4))
    within(found.mean["cross"], 0.0)  # the directions stay random


def test_a_unit_is_the_same_alone_and_in_any_chunk():
    whole = monte_carlo(pair, STACK, samples=5000, seed=7, keep=True)
    parts = monte_carlo(pair, STACK, samples=5000, seed=7, keep=True, chunk=1024)
    for name in ("sum", "largest"):
        np.testing.assert_allclose(parts.values[name], whole.values[name], rtol=1e-12, atol=1e-18)
        assert len(whole.values[name]) == 5000
    again = monte_carlo(pair, STACK, samples=5000, seed=7, keep=True)
    np.testing.assert_array_equal(again.values["sum"], whole.values["sum"])  # identical bits
    for index in (0, 1023, 1024, 4999):
        alone = pair(sample(STACK, index, seed=7))
        np.testing.assert_allclose(alone["sum"], whole.values["sum"][index], rtol=1e-12)
    batch = jax.jit(jax.vmap(lambda i: pair(sample(STACK, i, seed=7))["sum"]))(jnp.arange(4990, 5000))
    np.testing.assert_allclose(batch, whole.values["sum"][4990:], rtol=1e-12)
    assert (
        np.abs(monte_carlo(pair, STACK, samples=5000, seed=8, keep=True).values["sum"] - whole.values["sum"]).min() > 0
    )


def test_the_limits_only_scale_the_numbers_of_a_unit():
    one, two = (sample({"a": Tolerance.symmetric(t), "b": Tolerance.symmetric(1.0)}, 11, seed=5) for t in (1.0, 2.0))
    np.testing.assert_allclose(two["a"], 2 * one["a"])
    np.testing.assert_array_equal(two["b"], one["b"])


def test_chunks_change_neither_counts_nor_figures():
    limits = {"sum": Requirement(upper=8 * um), "largest": Requirement(upper=7 * um)}
    runs = [monte_carlo(pair, STACK, samples=20_000, seed=2, chunk=c, requirements=limits) for c in (4096, 5000, 65536)]
    for other in runs[1:]:
        for name in ("sum", "largest"):
            assert other.yield_[name] == runs[0].yield_[name]
            assert other.mean[name].value == pytest.approx(runs[0].mean[name].value, rel=1e-9, abs=1e-12 * um)
            assert other.sd[name].value == pytest.approx(runs[0].sd[name].value, rel=1e-12)
            assert other.quantiles[0.5][name].value == pytest.approx(runs[0].quantiles[0.5][name].value, rel=1e-9)
        assert other.joint_yield == runs[0].joint_yield
    assert runs[0].joint_yield.value < min(runs[0].yield_["sum"].value, runs[0].yield_["largest"].value)


def test_one_compilation_serves_every_tolerance_and_every_chunk():
    monte_carlo(pair, STACK, samples=2500, seed=0, chunk=1000)
    compiled = programs(respond, pair)
    wider = {name: t.with_half_width(2 * t.half_width) for name, t in STACK.items()}
    monte_carlo(pair, wider, samples=7200, seed=1, chunk=1000, requirements={"sum": LIMITS})
    assert programs(respond, pair) == compiled


def test_histogram_quantiles_equal_kept_ones_within_a_bin():
    kept = monte_carlo(linear, STACK, samples=30_000, seed=4, keep=True, quantiles=(0.001, 0.3, 0.999))
    coarse = monte_carlo(linear, STACK, samples=30_000, seed=4, quantiles=(0.001, 0.3, 0.999))
    bin_width = 2 * (kept.maximum - kept.minimum) / 2**16
    for p, exact in kept.quantiles.items():
        assert exact.value == np.quantile(kept.values, p)
        for end in ("value", "lower", "upper"):
            assert getattr(coarse.quantiles[p], end) == pytest.approx(getattr(exact, end), abs=bin_width)
        assert exact.error == pytest.approx((exact.upper - exact.lower) / (2 * 1.959964), rel=1e-6)


def life(e):
    return 1e4 * jnp.abs(2 + e["a"]) ** (-10 / 3)


def test_the_median_of_a_heavy_tail_is_that_of_kept_values():
    """A life: the largest of the first units is 1e13 times the median."""
    one = {"a": Tolerance.symmetric(3.0)}
    # |2 + a| has its median at x with Phi(x - 2) - Phi(-x - 2) = 1/2.
    x = optimize.brentq(lambda x: stats.norm.cdf(x - 2) - stats.norm.cdf(-x - 2) - 0.5, 0, 10)
    for method in ("random", "sobol"):
        kept, found = (
            monte_carlo(life, one, samples=200_000, seed=1, chunk=30_000, method=method, keep=keep).quantiles[0.5]
            for keep in (True, False)
        )
        assert found.lower < 1e4 * x ** (-10 / 3) < found.upper < 1.03 * found.lower
        assert found.lower <= kept.value <= found.upper
        assert found.error < kept.error + 0.3  # two bins


def failing(e):
    value = jnp.where(e["a"] > 6 * um, jnp.nan, e["a"])
    status = jnp.where(e["b"] > 6 * um, int(Status.NOT_ASSEMBLABLE), int(Status.UNLOADED))
    return Outcome({"y": value, "z": e["b"]}, jnp.stack([jnp.full_like(status, int(Status.CONVERGED)), status]))


def test_the_joint_yield_counts_units_within_all_limits():
    """Of two independent normal responses within one and two sd: the product of both shares."""
    given = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0)}  # sd 1
    limits = {"a": Requirement(upper=1.0), "b": Requirement(lower=-2.0)}
    found = monte_carlo(lambda e: dict(e), given, samples=4096, seed=5, requirements=limits)
    both = stats.norm.cdf(1.0) * stats.norm.cdf(2.0)
    assert abs(found.joint_yield.value - both) < 4 * np.sqrt(both * (1 - both) / 4096)
    assert found.joint_yield.value < found.yield_["a"].value < found.yield_["b"].value


def test_failed_units_are_rejects_with_a_reason():
    found = monte_carlo(
        failing, STACK, samples=20_000, seed=1, chunk=3000, keep=True, requirements={"y": Requirement(upper=1.0)}
    )
    units = jax.jit(jax.vmap(lambda i: sample(STACK, i, seed=1)))(jnp.arange(20_000))
    a, b = np.asarray(units["a"]), np.asarray(units["b"])
    nan, blocked = a > 6 * um, b > 6 * um
    assert found.failures == {"NONFINITE": int((nan & ~blocked).sum()), "NOT_ASSEMBLABLE": int(blocked.sum())}
    assert found.failed == int((nan | blocked).sum())
    assert found.yield_["y"].value == pytest.approx(1 - found.failed / 20_000)
    assert found.worst_index == found.examples["NONFINITE"] == int(np.argmax(nan & ~blocked))
    assert found.examples["NOT_ASSEMBLABLE"] == int(np.argmax(blocked))
    good = ~(nan | blocked)
    assert found.mean["z"].value == pytest.approx(b[good].mean(), rel=1e-9)
    assert found.quantiles[0.5]["y"].value == pytest.approx(np.median(a[good]), rel=1e-9)
    np.testing.assert_array_equal(np.isnan(found.values["z"]), ~good)


def test_every_unit_failed():
    found = monte_carlo(lambda e: e["a"] * jnp.nan, STACK, samples=100, seed=0, requirements=LIMITS)
    assert (found.failed, found.yield_.value, found.ppm.value, found.worst_index) == (100, 0.0, 1e6, 0)
    assert math.isnan(found.mean.value)
    assert math.isnan(found.sd.value)
    assert math.isnan(found.quantiles[0.5].value)


def test_one_unit_and_chunks_larger_than_the_sample():
    found = monte_carlo(linear, STACK, samples=1, seed=0, requirements=LIMITS)
    assert found.mean.value == found.minimum == found.maximum == found.quantiles[0.5].value
    assert math.isnan(found.sd.value)
    assert found.yield_.upper == 1.0
    assert found.yield_.lower < 0.3
    assert math.isinf(found.quantiles[0.99865].upper)  # one unit bounds no quantile


def test_zero_width_everywhere():
    fixed = {name: Tolerance(2 * um, 2 * um) for name in "abc"}
    found = monte_carlo(linear, fixed, samples=9_999, seed=0, requirements=LIMITS, chunk=1000)
    assert found.sd.value == 0.0
    assert found.mean.value == pytest.approx(4 * um)
    assert found.cpk == math.inf
    assert found.yield_.value == 1.0
    assert found.quantiles[0.99865].value == pytest.approx(4 * um, rel=1e-9)


def test_no_active_field_and_thirty_two():
    found = monte_carlo(lambda e: e["a"] + 1.0, {"a": None}, samples=10, seed=0)
    assert (found.mean.value, found.sd.value) == (1.0, 0.0)
    many = many_fields(32)
    found = monte_carlo(many.response, many.tolerances, samples=20_000, seed=0)
    within(found.sd, math.hypot(*many.response.slopes.values()) * 5 * um / 3)


def test_extreme_targets_and_intervals():
    for target in (0.5, 1 - 1e-6):
        found = monte_carlo(linear, STACK, samples=10_000, seed=0, requirements=Requirement(upper=1.0, target=target))
        assert found.yield_.value == 1.0
    share = wilson(3, 10, 0.95)  # Brown, Cai and DasGupta's textbook value
    assert (share.lower, share.upper) == pytest.approx((0.10779, 0.60322), abs=1e-5)
    assert (wilson(0, 10, 0.95).lower, wilson(10, 10, 0.95).upper) == (0.0, 1.0)


def test_for_design_fills_shapes():
    bore = Tolerance(0.0, 6 * um, distribution="rayleigh")
    tolerances = for_design(
        rvjax.catalogue.RV_40E, crank_eccentricity=bore, disc_bore=bore, eccentricity=Tolerance.grade("IT5", 3 * mm)
    )
    assert tolerances.disc_bore.shape == (2, 2, 2)
    assert tolerances.disc_bore.is_vector
    assert not tolerances.crank_eccentricity.is_vector  # two cranks are no [radial, tangential]
    assert tolerances.crank_phase is None
    errors = jax.jit(lambda: sample(tolerances, 0, seed=0))()
    assert errors.crank_eccentricity.shape == (2, 2)
    assert (errors.crank_eccentricity > 0).all()
    assert errors.eccentricity.shape == ()
    eager = sample(for_design(rvjax.catalogue.RV_40E, eccentricity=tolerances.eccentricity), 0, seed=0)
    assert type(eager.crank_phase) is float
    assert eager.crank_phase == 0.0


def test_a_sampled_preload_passes_where_an_eager_one_is_refused():
    tolerances = for_design(rvjax.catalogue.RV_40E, bearing_clearance=Tolerance(-3 * um, -2 * um))
    assert sample(tolerances, 0, seed=0).bearing_clearance < 0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: for_design(rvjax.catalogue.RV_40E, bore=STACK["a"]), "RVErrors has no field 'bore'"),
        (lambda: for_design(rvjax.catalogue.RV_40E, disc_bore=5e-6), "disc_bore = 5e-06: must be a Tolerance or None"),
        (
            lambda: for_design(rvjax.catalogue.RV_40E, disc_bore=Tolerance.symmetric(1.0, shape=(2,))),
            r"disc_bore: Tolerance.shape = \(2,\) does not fit this design, expected \(2, 2, 2\)",
        ),
        (lambda: sample({"a": "IT6"}, 0, seed=0), "tolerances: a = 'IT6' must be a Tolerance or None"),
        (lambda: sample(STACK["a"], 0, seed=0), "tolerances: must be a record or a dict"),
        (lambda: sample(STACK, -1, seed=0), "index = -1"),
        (lambda: sample(STACK, 0, seed=1.5), "seed = 1.5: must be a whole number"),
        (lambda: sample(STACK, 0, seed=2**70), "seed = 1180591620717411303424: .* at most 64 bits"),
        (lambda: sample(STACK, 0, seed=0, method="latin"), "method = 'latin'"),
        (lambda: monte_carlo(linear, STACK, samples=0, seed=0), "samples = 0: must be at least 1"),
        (lambda: monte_carlo(linear, STACK, samples=9, seed=0, chunk=0), "chunk = 0: must be at least 1"),
        (lambda: monte_carlo(linear, STACK, samples=9, seed=0, quantiles=(1.0,)), "quantiles: 1.0 must lie between"),
        (lambda: monte_carlo(linear, STACK, samples=9, seed=0, confidence=2), "confidence = 2"),
        (lambda: monte_carlo(three, STACK, samples=9, seed=0), r"must be one real number per unit, got shape \(3,\)"),
        (lambda: monte_carlo(pair, STACK, samples=9, seed=0, requirements=LIMITS), "the response has the names"),
        (lambda: monte_carlo(pair, STACK, samples=9, seed=0, requirements={"x": LIMITS}), "'x' is no name"),
        (lambda: Requirement(), "needs a lower or an upper limit"),
        (lambda: Requirement(lower=2.0, upper=1.0), "Requirement.lower = 2: lies above upper = 1"),
        (lambda: Requirement(upper=1.0, target=99.73), "Requirement.target = 99.73: must lie between 0 and 1"),
        (lambda: Requirement(upper="1 mm"), "Requirement.upper = '1 mm': must be a number"),
    ],
)  # fmt: skip
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_progress_bar(capsys):
    monte_carlo(linear, STACK, samples=1000, seed=0, progress=True)
    said = capsys.readouterr().err
    assert said.index("compiling") < said.rindex("Monte Carlo: 100%")


def test_programs_that_a_command_keeps_give_the_same_bits(request):
    options = dict(samples=9000, seed=4, chunk=1000, requirements={"sum": LIMITS}, keep=True)
    alone = monte_carlo(pair, STACK, **options)
    request.getfixturevalue("kept_programs")
    together = monte_carlo(pair, STACK, **options)
    for name in ("sum", "largest"):
        np.testing.assert_array_equal(together.values[name], alone.values[name])
    assert together.mean == alone.mean and together.joint_yield == alone.joint_yield


def test_random_numbers_of_any_units_are_their_own():
    population = Population.of(STACK)
    units = np.array([5, BLOCK + 1, 2, 3 * BLOCK - 1])
    found = numbers_of(population, root_key(3), units)
    np.testing.assert_allclose(found, population.draw(root_key(3), jnp.asarray(units, jnp.uint32)), rtol=1e-13)
