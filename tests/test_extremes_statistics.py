"""Statistics where something goes wrong: NaN from a response, no unit left, no memory, no disk, hostile studies.

Oracle: closed forms of the few numbers left, and that a failure is one clear line that loses nothing.
"""

import os
import warnings

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax.study import StudyError
from rvjax.study.read import EMBEDDED, parse_study
from rvjax.tolerances import Requirement, Tolerance, checkpoint, monte_carlo, save
from rvjax.tolerances.atomic import write_atomically

GOOD = (EMBEDDED / "rv-40e.toml").read_text()
ONE = {"a": Tolerance(-3.0, 3.0)}


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
    monkeypatch.setattr(checkpoint, "EVERY", 0)
    monkeypatch.setattr(checkpoint, "_SHARE", 0)
    options = dict(samples=4000, seed=1, chunk=1000)
    expected = monte_carlo(lambda e: e["a"], ONE, **options)
    calls = []

    def full(path, content):
        calls.append(path)
        if len(calls) > 2:
            raise OSError(28, "No space left on device")
        write_atomically(path, content)

    monkeypatch.setattr(checkpoint, "write_atomically", full)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = monte_carlo(lambda e: e["a"], ONE, checkpoint=tmp_path / "c", **options)
    assert found.mean == expected.mean and len(calls) > 3
    assert [path.name for path in tmp_path.iterdir()] == ["c"]


def test_a_full_disk_leaves_the_older_result(tmp_path, monkeypatch):
    result, path = monte_carlo(lambda e: e["a"], ONE, samples=100, seed=1), tmp_path / "a.json"
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
