"""Results as files.

Oracle: the result before it was saved, leaf by leaf: the same types and the same bits.
"""

import dataclasses
import json
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rvjax
from rvjax import RVErrors
from rvjax.tolerances import (
    Outcome,
    ReciprocalPower,
    Requirement,
    Tolerance,
    allocate,
    for_design,
    load,
    monte_carlo,
    origin,
    rss,
    save,
    saving,
    worst_case,
)
from rvjax.units import um
from tests.oracles.responses import Linear

STACK = {name: Tolerance.symmetric(size) for name, size in dict(a=3.0, b=2.0, c=1.0).items()}
STUDY = dict(samples=500, seed=3, requirements={"y": Requirement(upper=3.0)})


def response(e):
    return Outcome({"y": jnp.where(e["b"] < -1.0, jnp.nan, e["a"]), "z": e["c"]}, 0)


line = Linear(dict(a=1.0, b=2.0, c=0.0))


def same(one, two):
    if isinstance(one, (np.ndarray, jax.Array)):
        a = np.asarray(one)
        assert isinstance(two, np.ndarray) and a.dtype == two.dtype and a.shape == two.shape
        assert a.tobytes() == two.tobytes() or (a.dtype.kind == "f" and np.array_equal(a, two, equal_nan=True))
        return
    assert type(one) is type(two)
    if dataclasses.is_dataclass(one):
        for f in dataclasses.fields(one):
            same(getattr(one, f.name), getattr(two, f.name))
    elif isinstance(one, dict):
        assert list(one) == list(two)
        for key in one:
            same(one[key], two[key])
    elif isinstance(one, (list, tuple)):
        assert len(one) == len(two)
        for a, b in zip(one, two):
            same(a, b)
    else:
        assert one == two or (isinstance(one, float) and math.isnan(one) and math.isnan(two))


def results():
    design = rvjax.catalogue.RV_40E
    tolerances = for_design(design, disc_bore=Tolerance.grade("IT6", 0.025), pin_radius=Tolerance(-3 * um, 2 * um))

    def gap(e):
        return jnp.sum(e.disc_bore**2) + e.pin_radius

    cost = ReciprocalPower(finest=0.1, coarsest=9.0, reference=1.0)
    limit = Requirement(upper=2.0)
    return {
        "one unit": monte_carlo(response, STACK, samples=1, seed=0),
        "every unit": monte_carlo(response, STACK, keep=True, **STUDY),
        "sobol": monte_carlo(line, STACK, samples=500, seed=2**60, method="sobol"),
        "worst case": worst_case(gap, tolerances),
        "moments": rss(gap, tolerances),
        "allocation": allocate(
            line, STACK, limit, costs={"a": cost, "b": cost}, samples=4096, certificate_samples=4096, max_steps=2
        ),
        "errors": RVErrors.for_design(design, disc_bore=1 * um),
        "plain": {"none": None, 1: (True, -0.0, [math.inf, -math.inf]), "$x": np.float32(2.5), "e": np.zeros((0, 3))},
    }


@pytest.fixture(scope="module")
def saved():
    return results()


@pytest.mark.parametrize("ending", ["json", "npz"])
def test_every_result_comes_back(saved, tmp_path, ending):
    path = tmp_path / f"result.{ending}"
    for name, result in saved.items():
        save(result, path)
        back = load(path)
        if name == "plain":  # a NumPy number comes back as an array without axes
            assert back.pop("$x") == np.float32(2.5) and math.copysign(1, back[1][1]) == -1
            result = {key: value for key, value in result.items() if key != "$x"}
        same(result, back)
        assert [file.name for file in tmp_path.iterdir()] == [path.name]


def test_a_result_tells_where_it_comes_from(saved, tmp_path):
    path = tmp_path / "a.json"
    save(saved["every unit"], path)
    found = origin(path)
    assert (found.kind, found.seed) == ("Statistics", 3)
    assert found.versions["rvjax"] == rvjax.__version__ and found.versions["jax"] == jax.__version__
    assert found.study["tolerances.b"] == "normal -2.0 .. 2.0, cp 1.0"
    assert found.study["requirements.y"].startswith("Requirement(lower=-inf, upper=3.0")
    assert saved["every unit"].study == found.study and saved["every unit"].versions == found.versions
    save(saved["moments"], path, study="two fields", seed=8)
    assert (origin(path).kind, origin(path).seed, origin(path).study) == ("Moments", 8, "two fields")
    json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def test_samples_take_eight_bytes_each_in_npz(tmp_path):
    save(monte_carlo(line, STACK, samples=50_000, seed=0, keep=True), tmp_path / "a.npz")
    assert (tmp_path / "a.npz").stat().st_size < 8 * 50_000 + 10_000


@pytest.mark.parametrize("ending", ["json", "npz"])
@pytest.mark.parametrize("damage", ["cut", "empty", "text"])
def test_damaged_files_are_named(saved, tmp_path, ending, damage):
    path = tmp_path / f"a.{ending}"
    save(saved["every unit"], path)
    path.write_bytes({"cut": path.read_bytes()[:-40], "empty": b"", "text": b"[1, 2]"}[damage])
    for read in (load, origin):
        with pytest.raises(ValueError, match=rf"a\.{ending}: damaged, or no result of rvjax"):
            read(path)


def test_files_that_cannot_be_read_or_written_are_named(saved, tmp_path, monkeypatch):
    path = tmp_path / "a.json"
    save(saved["one unit"], path)
    whole = path.read_text()
    path.write_text(whole.replace('"format": 2', '"format": 1'))
    with pytest.raises(ValueError, match="has format 1, this version of rvjax reads 2"):
        load(path)
    path.write_text(whole.replace('"$": "Statistics"', '"$": "Oracle"'))
    with pytest.raises(ValueError, match="this version of rvjax has no result 'Oracle'"):
        load(path)
    path.write_text(whole.replace('"confidence"', '"trust"'))
    with pytest.raises(ValueError, match="Statistics has other fields in this version of rvjax: confidence, trust"):
        load(path)
    with pytest.raises(ValueError, match=r"must end with .json or .npz"):
        save(saved["one unit"], tmp_path / "a.txt")
    with pytest.raises(ValueError, match="object fits no file"):
        save({"x": object()}, path)
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "absent.json")

    def full(*_):
        raise OSError(28, "No space left on device")

    path.write_text(whole)
    monkeypatch.setattr(saving, "write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        save(saved["moments"], path)
    assert path.read_text() == whole
