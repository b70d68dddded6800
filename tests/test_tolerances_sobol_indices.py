"""Sobol indices.

Oracles: the closed forms of the Ishigami function, of linear models and of products; SALib's analysis of the same
function. An index must lie within 4 of its own standard errors (15 degrees of freedom: 1 in 1000), and that error be
small; a field that does not enter has indices of exactly 0.
"""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from rvjax.status import Status
from rvjax.tolerances import Outcome, Tolerance, sobol_indices

ANGLE = Tolerance.symmetric(math.pi, distribution="uniform")
ISHIGAMI = {"x1": ANGLE, "x2": ANGLE, "x3": ANGLE, "x4": ANGLE}
A, B = 7.0, 0.1
VARIANCE = A**2 / 8 + B * math.pi**4 / 5 + B**2 * math.pi**8 / 18 + 0.5
FIRST = {"x1": (1 + B * math.pi**4 / 5) ** 2 / 2 / VARIANCE, "x2": A**2 / 8 / VARIANCE, "x3": 0.0, "x4": 0.0}
CROSSED = B**2 * math.pi**8 * (1 / 18 - 1 / 50) / VARIANCE
TOTAL = {"x1": FIRST["x1"] + CROSSED, "x2": FIRST["x2"], "x3": CROSSED, "x4": 0.0}


def ishigami(e):
    return jnp.sin(e["x1"]) + A * jnp.sin(e["x2"]) ** 2 + B * e["x3"] ** 4 * jnp.sin(e["x1"])


def agree(found, exact, error):
    for name, share in found.items():
        assert abs(share.value - exact[name]) <= 4 * share.error + 1e-14, name
        assert share.error < error
        assert share.lower <= share.value <= share.upper


@pytest.fixture(scope="module")
def of_ishigami():
    return sobol_indices(ishigami, ISHIGAMI, samples=16384, seed=0)


def test_ishigami(of_ishigami):
    assert (FIRST["x1"], FIRST["x2"], TOTAL["x1"], TOTAL["x3"]) == pytest.approx(
        (0.3139, 0.4424, 0.5576, 0.2437), abs=1e-4
    )
    agree(of_ishigami.first, FIRST, 0.006)
    agree(of_ishigami.total, TOTAL, 0.006)
    assert of_ishigami.evaluations == 16384 * 6
    assert (of_ishigami.used, of_ishigami.failed) == (16384, 0)


def test_a_field_that_does_not_enter_has_exactly_no_share(of_ishigami):
    for share in (of_ishigami.first["x4"], of_ishigami.total["x4"]):
        assert (share.value, share.error, share.lower, share.upper) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("size", [2.0**-990, 2.0**1010])
def test_the_size_of_a_response_does_not_matter(size):
    """The square of 1e160 is no number, and that of 1e-300 is zero."""
    plain, sized = (sobol_indices(lambda e, s=s: s * ishigami(e), ISHIGAMI, samples=64, seed=0) for s in (1.0, size))
    for one, other in ((sized.first, plain.first), (sized.total, plain.total)):
        for name in ISHIGAMI:
            assert dataclasses.astuple(one[name]) == pytest.approx(dataclasses.astuple(other[name]), rel=1e-9)
    assert sized.trusted is plain.trusted


def test_chunks_do_not_matter(of_ishigami):
    parts = sobol_indices(ishigami, ISHIGAMI, samples=16384, seed=0, chunk=3000)
    for name in ISHIGAMI:
        assert parts.total[name].value == pytest.approx(of_ishigami.total[name].value, rel=1e-12, abs=1e-14)
        assert parts.total[name].error == pytest.approx(of_ishigami.total[name].error, rel=1e-9, abs=1e-14)
    odd = [sobol_indices(ishigami, ISHIGAMI, samples=1000, seed=0, chunk=chunk) for chunk in (77, 65536)]
    assert odd[0].total["x1"].value == pytest.approx(odd[1].total["x1"].value, rel=1e-12)


def test_errors_are_honest():
    """Forty seeds of 512 rows: the scatter is what each run says of itself."""
    runs = [sobol_indices(ishigami, ISHIGAMI, samples=512, seed=seed) for seed in range(40)]
    for exact, pick in ((FIRST["x2"], lambda r: r.first["x2"]), (TOTAL["x1"], lambda r: r.total["x1"])):
        values, errors = (np.array([getattr(pick(r), part) for r in runs]) for part in ("value", "error"))
        assert 0.6 < values.std(ddof=1) / math.sqrt((errors**2).mean()) < 1.6
        assert abs(values.mean() - exact) < 4 * values.std(ddof=1) / math.sqrt(40)


@pytest.mark.long  # the closed forms run by default
def test_salib_finds_the_same(of_ishigami):
    """SALib with its own scrambled points on the same function."""
    analyze = pytest.importorskip("SALib.analyze.sobol")
    sample = pytest.importorskip("SALib.sample.sobol")
    problem = {"num_vars": 4, "names": list(ISHIGAMI), "bounds": [[-math.pi, math.pi]] * 4}
    x = sample.sample(problem, 4096, calc_second_order=False, seed=1)
    y = np.asarray(ishigami(dict(zip(ISHIGAMI, x.T))))
    theirs = analyze.analyze(problem, y, calc_second_order=False, num_resamples=30, seed=1)
    for k, name in enumerate(ISHIGAMI):
        for ours, key in ((of_ishigami.first, "S1"), (of_ishigami.total, "ST")):
            apart = abs(ours[name].value - theirs[key][k])
            assert apart <= 4 * ours[name].error + 2 * theirs[key + "_conf"][k] + 1e-12


def test_linear_model_of_groups_and_laws():
    """An array field is one group; shares are those of the variances, first and total alike."""
    tolerances = {
        "v": Tolerance.symmetric(3.0, shape=(3,), batch=0.5),
        "u": Tolerance(-1.0, 3.0, distribution="uniform"),
        "idle": None,
        "fixed": Tolerance(2.0, 2.0),
        "r": Tolerance(0.0, 6.0, distribution="rayleigh", shape=(2,)),
    }
    response = lambda e: 1e3 + jnp.sum(e["v"]) - 2 * e["u"] + e["r"][1] + e["fixed"]  # noqa: E731
    variances = {"v": 3 + 6 * 0.5, "u": 4 * 4 / 3, "fixed": 0.0, "r": 4.0}
    exact = {name: v / sum(variances.values()) for name, v in variances.items()}
    found = sobol_indices(response, tolerances, samples=8192, seed=2)
    assert list(found.first) == list(found.total) == ["fixed", "r", "u", "v"]
    agree(found.first, exact, 0.01)
    agree(found.total, exact, 0.01)
    assert found.total["fixed"].value == 0.0


def test_failed_units_take_no_part():
    """Cutting x to |x| < 2 leaves y + c x on the rest: the closed form with the variance of the cut law."""
    tolerances = {"x": Tolerance.symmetric(3.0), "y": Tolerance.symmetric(3.0)}

    def response(e):
        lost = jnp.abs(e["x"]) > 2
        value = {"sum": jnp.where(lost, jnp.nan, e["x"] + e["y"]), "x": e["x"] ** 3}
        return Outcome(value, jnp.where(lost, int(Status.NOT_ASSEMBLABLE), int(Status.CONVERGED)))

    found = sobol_indices(response, tolerances, samples=8192, seed=3)
    cut = 1 - 4 * math.exp(-2) / math.sqrt(2 * math.pi) / math.erf(math.sqrt(2))  # variance of the cut normal law
    agree(found.first["sum"], {"x": cut / (1 + cut), "y": 1 / (1 + cut)}, 0.02)
    agree(found.total["x"], {"x": 1.0, "y": 0.0}, 0.02)
    lost = math.erfc(math.sqrt(2))
    assert found.used / 8192 == pytest.approx((1 - lost) ** 2, abs=0.01)
    assert found.failed / (4 * 8192) == pytest.approx(lost, abs=0.003)
    nothing = sobol_indices(lambda e: e["x"] * jnp.nan, tolerances, samples=64, seed=0)
    assert math.isnan(nothing.first["x"].value)
    assert nothing.used == 0


def life(power):
    """Of a and a factor of b: the variance exists for a power below a half."""
    return lambda e: jnp.abs(2 + e["a"]) ** -power * (1 + 0.3 * e["b"])


@pytest.mark.parametrize("samples", [1024, 16384])
def test_a_variance_that_does_not_exist_has_no_narrow_share(samples):
    """One unit has most of the sampled variance, and every share is about that unit."""
    pair = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0), "idle": Tolerance.symmetric(1.0)}
    both = lambda e: {"life": life(10 / 3)(e), "square": e["a"] ** 2 + e["b"]}  # noqa: E731
    for seed in range(4):
        found = sobol_indices(both, pair, samples=samples, seed=seed)
        assert found.trusted == {"life": False, "square": True}
        for shares in (found.first["life"], found.total["life"]):
            for name in "ab":
                assert shares[name].lower <= 0 and shares[name].upper >= 1 and shares[name].error == 0.5
        assert found.total["life"]["idle"].upper == 0.0  # exactly, whatever the variance
        agree(found.first["square"], {"a": 2 / 3, "b": 1 / 3, "idle": 0.0}, 0.06)


def test_the_variance_of_a_square_is_trusted():
    """Few units, of which the largest has a tenth of the variance or more: its fourth moment exists."""
    pair = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0)}
    response = lambda e: e["a"] ** 2 + e["b"]  # noqa: E731  one program for all seeds
    runs = [sobol_indices(response, pair, samples=128, seed=seed) for seed in range(20)]
    assert all(run.trusted and run.total["b"].upper < 1 for run in runs)


def test_a_variance_that_converges_slowly_has_honest_shares():
    """A power of 0.4: the fourth moment does not exist, the variance does. Oracle: quadrature.

    Of 40 intervals of 95 % less than 32 hold the truth once in a thousand cases.
    """
    pair, power = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(3.0)}, 0.4
    first, second = (
        integrate.quad(lambda x, k=k: x ** (-k * power) * (stats.norm.pdf(x - 2) + stats.norm.pdf(x + 2)), 0, 12)[0]
        for k in (1, 2)
    )
    variance = second * (1 + 0.3**2) - first**2
    exact = {"a": 1 - 0.09 * first**2 / variance, "b": 0.09 * second / variance}
    held, response = {"a": 0, "b": 0}, life(power)
    for seed in range(40):
        found = sobol_indices(response, pair, samples=1024, seed=seed)
        for name, share in found.total.items():
            held[name] += share.lower <= exact[name] <= share.upper
    assert min(held.values()) >= 32, held


def test_nothing_varies():
    fixed = {"x": Tolerance(1.0, 1.0), "y": None}
    assert sobol_indices(lambda e: e["x"] + e["y"], fixed, samples=64, seed=0).total["x"].value == 0.0
    assert sobol_indices(lambda e: e["x"], {"x": None}, samples=64, seed=0).first == {}


@pytest.mark.long  # closed forms of few fields run by default
def test_many_fields():
    tolerances = {f"e{k:03d}": Tolerance.symmetric(3.0 if k else 30.0) for k in range(200)}
    found = sobol_indices(lambda e: sum(e.values()), tolerances, samples=512, seed=4, chunk=512)
    assert sum(share.value for share in found.first.values()) == pytest.approx(1.0, abs=0.15)
    assert found.total["e000"].value == pytest.approx(100 / 299, abs=5 * found.total["e000"].error)


def test_bad_arguments_are_named():
    pair = {"x": ANGLE, "y": ANGLE}
    with pytest.raises(ValueError, match="independent fields only"):
        sobol_indices(lambda e: e["x"], pair, samples=64, seed=0, correlation={("x", "y"): 0.5})
    with pytest.raises(ValueError, match="samples = 31: must be at least 32"):
        sobol_indices(lambda e: e["x"], pair, samples=31, seed=0)
    with pytest.raises(ValueError, match="chunk = 0: must be at least 1"):
        sobol_indices(lambda e: e["x"], pair, samples=64, seed=0, chunk=0)
