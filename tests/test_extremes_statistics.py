"""Statistics where something goes wrong: NaN from a response, no unit left, no memory, no disk, hostile studies.

Oracle: closed forms of the few numbers left, and that a failure is one clear line that loses nothing.
"""

import os
import warnings

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from rvjax.base.files import PARTIAL, write_atomically
from rvjax.status import Status
from rvjax.study import StudyError
from rvjax.study.reader import EMBEDDED, parse_study
from rvjax.tolerances import (
    CpkAtLeast,
    MeanWithin,
    Outcome,
    Requirement,
    Tolerance,
    allocate,
    load,
    monte_carlo,
    save,
)
from rvjax.tolerances.batch import checkpoint
from rvjax.units import um
from tests.oracles.linear_pair import COSTS, LIMIT, PAIR, WIDE, linear
from tests.oracles.responses import Linear

GOOD = (EMBEDDED / "rv-40e.toml").read_text()
ONE = {"a": Tolerance(-3.0, 3.0)}
PLAIN = Linear({"a": 1.0})


def broken(errors):
    """Two thirds of the units give NaN or infinity without saying why."""
    a = errors["a"]
    return jnp.where(a > 0.5, jnp.nan, jnp.where(a < -0.5, jnp.inf, a))


def test_nan_from_a_response_is_a_reject_with_a_reason():
    found = monte_carlo(broken, ONE, samples=5000, seed=0, requirements=Requirement(upper=10.0), keep=True)
    values = np.asarray(found.values)
    assert found.failures == {"NONFINITE": found.failed}
    assert 0.5 < found.failed / found.samples < 0.7
    assert np.isnan(values).sum() == found.failed and not np.isinf(values).any()
    assert found.yield_.value == pytest.approx(1 - found.failed / 5000, abs=1e-12)
    assert np.isfinite(found.mean.value)


def endless(errors):
    """A life that one unit in six never ends, and one in a hundred that has none."""
    a = errors["a"]
    return jnp.where(a > 1, jnp.inf, jnp.where(a < -2.326, jnp.nan, 10 + a))


@pytest.mark.parametrize("method", ["random", "sobol"])
@pytest.mark.parametrize("keep", [True, False])
def test_an_infinite_life_meets_a_lower_limit(method, keep):
    """Oracle: counts of the errors themselves. The statistics say how many units are infinite; NaN stays a reject."""
    options = dict(samples=20_000, seed=0, method=method, keep=keep, quantiles=(0.5, 0.95))
    a = np.asarray(monte_carlo(PLAIN, ONE, **(options | dict(keep=True))).values)
    found = monte_carlo(endless, ONE, requirements=Requirement(lower=9.0), **options)
    mirrored = monte_carlo(lambda e: -endless(e), ONE, requirements=Requirement(upper=-9.0), **options)
    assert found.infinite == mirrored.infinite == (a > 1).sum() > 3000
    assert found.failures == mirrored.failures == {"NONFINITE": (a < -2.326).sum()}
    assert found.yield_.value == found.joint_yield.value == mirrored.yield_.value == (a >= -1).mean()
    body = 10 + a[(a <= 1) & (a >= -2.326)]
    assert found.mean.value == pytest.approx(body.mean()) and found.sd.value == pytest.approx(body.std(ddof=1))
    assert mirrored.mean.value == pytest.approx(-found.mean.value)
    for share, value in ((0.5, np.quantile(10 + a[a >= -2.326], 0.5)), (0.95, np.inf)):
        assert found.quantiles[share].value == pytest.approx(value, abs=1e-3)
        assert not np.isnan(found.quantiles[share].error)
    assert (found.maximum, mirrored.minimum) == (np.inf, -np.inf) and found.minimum == body.min()
    if keep:
        values = np.asarray(found.values)
        assert (values == np.inf).sum() == found.infinite and np.isnan(values).sum() == found.failed


def test_an_infinite_life_of_a_costly_response():
    """Solved by the programs of its parts."""

    def costly(errors):
        return endless(errors)

    costly.costly = True
    options = dict(samples=2000, seed=0, requirements=Requirement(lower=9.0))
    found, expected = (monte_carlo(each, ONE, **options) for each in (costly, endless))
    assert found.infinite == expected.infinite > 200 and found.failed == expected.failed
    assert found.yield_ == expected.yield_


@pytest.mark.parametrize("limits", [dict(upper=30.0), dict(lower=9.0, upper=30.0), None])
def test_an_infinite_response_that_no_limit_allows_has_failed(limits):
    found = monte_carlo(endless, ONE, samples=5000, seed=0, requirements=limits and Requirement(**limits))
    assert 0.1 < found.failed / found.samples < 0.2 and set(found.failures) == {"NONFINITE"}
    assert found.infinite == 0 and np.isfinite([found.mean.value, found.sd.value, found.maximum]).all()


def test_a_unit_that_says_it_failed_has_failed_whatever_its_value():
    said = lambda e: Outcome(endless(e), jnp.where(e["a"] > 1, int(Status.NONFINITE), int(Status.CONVERGED)))  # noqa: E731
    found = monte_carlo(said, ONE, samples=5000, seed=0, requirements=Requirement(lower=9.0))
    assert found.infinite == 0 and found.failed > 500 and found.yield_.value < 0.8


def test_infinite_units_are_missing_from_statistics_of_valid_ones():
    """Few enough failed, but a sixth is infinite: mean and Cpk of the others prove nothing."""
    life = lambda e: jnp.where(e["a"] > 1, jnp.inf, 10 + e["a"])  # noqa: E731
    for item in (CpkAtLeast(lower=1.0, cpk=1.0), MeanWithin(lower=1.0)):
        verdict = monte_carlo(life, ONE, samples=5000, seed=0, requirements=item).verdicts
        assert verdict.estimate.value > 1 and not verdict.met


@pytest.mark.long  # a Monte Carlo study, above, counts them alike
def test_a_certificate_counts_infinite_lives():
    """Half of all lives are infinite: of the others 2 % may miss the limit, where 1 % of all units may."""

    def life(errors):
        return {"life": jnp.where(errors["c"] > 0, jnp.inf, linear(errors))}

    limits = {"life": Requirement(lower=-LIMIT, target=0.99)}
    three = PAIR | {"c": Tolerance.symmetric(1.0)}
    found = allocate(life, three, limits, costs=COSTS | {"c": None}, samples=4096, certificate_samples=50_000)
    sd = np.sqrt(found.half_widths["a"] ** 2 + 4 * found.half_widths["b"] ** 2) / 3
    certified = found.certificate.yield_["life"]
    assert found.feasible and certified.lower >= 0.99 and found.certificate.failed == 0
    assert found.certificate.infinite["life"] == pytest.approx(25_000, abs=500)
    assert abs(certified.value - (1 - stats.norm.cdf(-LIMIT / sd) / 2)) <= 4 * certified.error


def test_infinite_units_are_kept_in_files_and_checkpoints(tmp_path):
    options = dict(samples=9000, seed=1, chunk=1000, requirements=Requirement(lower=9.0))
    expected = monte_carlo(endless, ONE, **options)
    monte_carlo(endless, ONE, checkpoint=tmp_path / "c", **(options | dict(samples=3000)))
    found = monte_carlo(endless, ONE, checkpoint=tmp_path / "c", save=tmp_path / "u.csv", **options)
    for name in ("mean", "quantiles", "yield_", "infinite", "maximum"):
        assert getattr(found, name) == getattr(expected, name)
    rows = [line.split(",") for line in (tmp_path / "u.csv").read_text().splitlines()[1:]]
    assert sum(row[2] == "inf" for row in rows) == found.infinite
    assert sum(row[1] == "NONFINITE" and not row[2] for row in rows) == found.failed
    save(found, tmp_path / "a.json")
    assert load(tmp_path / "a.json").infinite == found.infinite


@pytest.mark.parametrize("samples", [1, 7])
def test_no_unit_left(samples):
    found = monte_carlo(lambda e: e["a"] * jnp.nan, ONE, samples=samples, seed=0, requirements=Requirement(upper=1.0))
    assert found.failed == samples and found.yield_.value == 0
    assert np.isnan(found.mean.value)


def test_units_that_fit_no_memory_are_refused():
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    names = [f"y{i}" for i in range(1 + memory // 8 // 2**32)]
    with pytest.raises(ValueError, match=r"keep = True: 4000000000 units need .* GiB") as caught:
        monte_carlo(lambda e: dict.fromkeys(names, e["a"]), ONE, samples=4_000_000_000, seed=0, keep=True)
    assert "\n" not in str(caught.value)


def test_a_full_disk_where_warnings_are_errors(tmp_path, monkeypatch, capsys):
    """The study ends with the same numbers, and the older checkpoint stays."""
    options = dict(samples=4000, seed=1, chunk=1000)
    expected = monte_carlo(PLAIN, ONE, **options)
    calls = []

    def full(path, content):
        calls.append(path)
        if len(calls) > 2:
            raise OSError(28, "No space left on device")
        write_atomically(path, content)

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = monte_carlo(PLAIN, ONE, checkpoint=tmp_path / "c", checkpoint_every=0, **options)
    assert found.mean == expected.mean and len(calls) > 3
    assert [path.name for path in tmp_path.iterdir()] == ["c"]


def test_a_full_disk_leaves_the_older_result(tmp_path, monkeypatch):
    result, path = monte_carlo(PLAIN, ONE, samples=100, seed=1), tmp_path / "a.json"
    save(result, path)
    before = path.read_bytes()

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        save(result, path)
    assert path.read_bytes() == before and [file.name for file in tmp_path.iterdir()] == ["a.json"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("seed = 0", "seed = " + "9" * 40, ["run.seed", "at most"]),
        ("seed = 0", "seed = " + "9" * 6000, ["digits"]),
        ("seed = 0", "seed = 0\nx = " + "[" * 100_000, ["TOML"]),
        ("angles = 64", "angles = 1000000000000", ["conditions.angles", "at most"]),
        ('"412 N m"', '"nan N m"', ["output_torque", "finite"]),
        ('"5 arcmin"\n\n[tolerances.disc', '"1e400 arcmin"\n\n[tolerances.disc', ["crank_phase", "finite"]),
        ("scale = 6", "scale = inf", ["scale", "finite"]),
        ("scale = 6", "scale = 1979-05-27", ["scale", "number"]),
        ('base = "rv-40e"', 'base = "../../etc/passwd"', ["design.base", "must be one of"]),
        ('base = "rv-40e"', 'base = ["rv-40e"]', ["design.base", "must be one of"]),
        ('base = "rv-40e"', 'base = "rv-40e"\ncranks.count = 1000000000', ["cranks.count", "at most 64"]),
        ('base = "rv-40e"', 'base = "rv-40e"\ncycloid.disc_teeth = 1000000000', ["disc_teeth", "at most"]),
        ('base = "rv-40e"', 'base = "rv-40e"\n__class__ = 3', ["__class__"]),
        ('upper = "30 um"', 'upper = "30 ' + "u" * 5000 + '"', ["requirement.misfit.upper"]),
        ("[run]", '["a\\nb"]\nx = 1\n[run]', ["unknown key"]),
    ],
)
def test_hostile_studies_are_one_short_line(old, new, words):
    assert old in GOOD
    with pytest.raises(StudyError, match=r"^bad: ") as caught:
        parse_study(GOOD.replace(old, new, 1), name="bad")
    message = str(caught.value)
    assert "\n" not in message and len(message) < 500
    assert all(word in message for word in words), message


def test_a_folder_that_cannot_be_written(tmp_path, monkeypatch):
    """Read-only from the start: refused before any work. Read-only later: the study ends, the old state stays."""

    def read_only(path, content):
        raise OSError(30, "Read-only file system", str(path))

    options = dict(samples=3000, seed=1, chunk=1000)
    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write_atomically", read_only)
        with pytest.raises(OSError, match="Read-only"):
            monte_carlo(PLAIN, ONE, checkpoint=tmp_path / "c", **options)
    assert not list(tmp_path.iterdir())
    expected = monte_carlo(PLAIN, ONE, checkpoint=tmp_path / "c", **options)
    before = (tmp_path / "c").read_bytes()
    monkeypatch.setattr(checkpoint, "write_atomically", read_only)
    with pytest.warns(RuntimeWarning, match="cannot be written"):
        found = monte_carlo(PLAIN, ONE, checkpoint=tmp_path / "c", checkpoint_every=0, **(options | {"samples": 6000}))
    assert found.samples == 6000 and (tmp_path / "c").read_bytes() == before
    assert expected.samples == 3000


def test_a_write_that_was_cut_off_is_not_read(tmp_path):
    """What a killed process leaves beside a checkpoint is a part of a file: the whole one counts."""
    options = dict(samples=3000, seed=1, chunk=1000)
    expected = monte_carlo(PLAIN, ONE, **options)
    monte_carlo(PLAIN, ONE, checkpoint=tmp_path / "c", **(options | {"samples": 1000}))
    (tmp_path / ("c" + PARTIAL)).write_bytes((tmp_path / "c").read_bytes()[:100])
    found = monte_carlo(PLAIN, ONE, checkpoint=tmp_path / "c", **options)
    assert found.mean == expected.mean and found.sd == expected.sd


def test_limits_the_wrong_way_round_are_named():
    with pytest.raises(ValueError, match=r"Requirement.lower = 2: lies above upper = 1"):
        Requirement(lower=2, upper=1)


@pytest.mark.long  # test_codesign.py and test_cli_allocate.py have shortfalls
def test_requirements_that_contradict_each_other():
    """Two that no unit can meet end as INFEASIBLE, with how far off."""
    apart = {"low": Requirement(upper=-5 * um), "high": Requirement(lower=5 * um)}
    found = allocate(lambda e: {"low": linear(e), "high": linear(e)}, PAIR, apart, costs=COSTS, samples=512,
                     certificate_samples=2048)  # fmt: skip
    assert (found.feasible, found.status) == (False, "INFEASIBLE")
    finest = 3 * WIDE.finest / 3 * 5**0.5  # 3 sigma of a + 2 b at the finest
    for name in apart:
        assert found.shortfall[name] == pytest.approx(5 * um + finest, rel=0.1)
    assert found.tolerances["a"].upper == pytest.approx(WIDE.finest)


def test_tolerances_of_width_zero():
    """Every unit is the nominal one: certain where it meets the limit, impossible where it does not."""
    exact = {"a": Tolerance(2.0, 2.0), "b": Tolerance(-1.0, -1.0)}
    for upper, share in ((1.0, 1.0), (-1.0, 0.0)):
        found = monte_carlo(linear, exact, samples=100, seed=0, requirements=Requirement(upper=upper))
        assert (found.mean.value, found.sd.value, found.yield_.value) == (0, 0, share)
    single = monte_carlo(linear, exact, samples=1, seed=0, requirements=Requirement(upper=1.0))
    assert single.yield_.value == 1 and single.yield_.lower < 0.5
