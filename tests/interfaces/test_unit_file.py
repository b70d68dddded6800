"""Every unit of a run on disk: the numbers that were computed, to the bit, whatever was interrupted or added later.

Oracle: `sample` draws the errors of one unit, and a plain Python function its response (1e-13: a few roundings).
"""

import csv
import functools
import sys

import jax.numpy as jnp
import numpy as np
import pytest

from rvjax import cli, tolerances
from rvjax.base.files import versions
from rvjax.population.population import Population
from rvjax.response import Evaluator
from rvjax.status import Status
from rvjax.tolerances import Outcome, Requirement, Tolerance, UnitFile, monte_carlo, sample
from rvjax.tolerances.batch import unit_file
from rvjax.tolerances.batch.shares import Chunks

ERRORS = {"a": Tolerance(-2.0, 4.0), "b": Tolerance(0.0, 3.0, shape=(2, 2), distribution="uniform")}
OPTIONS = dict(samples=250, seed=3, chunk=100)


def product(e):
    """Fails where `a` is far out, about one unit of fifty."""
    far = jnp.where(e["a"] > 3.0, int(Status.SINGULAR), int(Status.CONVERGED))
    return Outcome({"y": e["a"] * e["b"][0, 1], "z": e["a"] - e["b"][1, 0]}, far)


REQUIREMENTS = {"y": Requirement(upper=4.0, target=0.9)}
run = functools.partial(monte_carlo, product, ERRORS, requirements=REQUIREMENTS, **OPTIONS)


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize("method", ["random", "sobol"])
def test_a_row_is_the_unit_that_was_evaluated(tmp_path, method):
    target = UnitFile(tmp_path / "u.csv", errors=True, units={"y": "rad", "a": "m"})
    found = run(method=method, save=target)
    table = rows(tmp_path / "u.csv")
    assert [int(row["unit"]) for row in table] == list(range(250))
    assert [row["status"] for row in table].count("SINGULAR") == found.failed > 0
    kept = run(method=method, keep=True).values
    for i, row in enumerate(table):
        drawn = [float(row["a [m]"]), *(float(row[f"b[{j},{k}]"]) for j in (0, 1) for k in (0, 1))]
        if i % 29 == 0:
            unit = sample(ERRORS, i, seed=3, method=method)
            np.testing.assert_allclose(drawn, [unit["a"], *np.ravel(unit["b"])], rtol=1e-13)
        if row["status"] == "SINGULAR":
            assert drawn[0] > 3.0 and row["y [rad]"] == row["z"] == ""
            continue
        assert drawn[0] <= 3.0 and float(row["y [rad]"]) == kept["y"][i] and float(row["z"]) == kept["z"][i]
        np.testing.assert_allclose(float(row["y [rad]"]), drawn[0] * drawn[2], rtol=1e-13)
        np.testing.assert_allclose(float(row["z"]), drawn[0] - drawn[3], rtol=1e-13, atol=1e-15)


def test_without_errors_there_are_only_responses(tmp_path):
    monte_carlo(lambda e: e["a"], ERRORS, save=tmp_path / "u.csv", **OPTIONS)
    assert list(rows(tmp_path / "u.csv")[0]) == ["unit", "status", "response"]


def test_a_table_begun_late_equals_one_from_the_start(tmp_path):
    """200 units are in the checkpoint; their rows come from the seed again, and no count changes."""
    whole = run(save=UnitFile(tmp_path / "a.csv", errors=True))
    run(checkpoint=tmp_path / "c", **{**OPTIONS, "samples": 200})
    found = run(checkpoint=tmp_path / "c", save=UnitFile(tmp_path / "b.csv", errors=True))
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    assert found.mean == whole.mean and found.yield_ == whole.yield_ and found.failures == whole.failures


def test_responses_added_to_a_checkpoint_without_them(tmp_path, monkeypatch):
    """Figures and values are those of a run that kept them from the start, and the next run finds them in the file."""
    whole = run(keep=True)
    run(checkpoint=tmp_path / "c", **{**OPTIONS, "samples": 200})
    found = run(checkpoint=tmp_path / "c", keep=True)
    for name in ("mean", "sd", "quantiles", "yield_", "failures", "examples", "joint_yield"):
        assert getattr(found, name) == getattr(whole, name), name
    for name in ("y", "z"):
        np.testing.assert_array_equal(found.values[name], whole.values[name])
    started, start = [], Evaluator.start
    monkeypatch.setattr(Evaluator, "start", lambda self, first: started.append(first) or start(self, first))
    again = run(checkpoint=tmp_path / "c", keep=True)
    assert started == [200]
    np.testing.assert_array_equal(again.values["y"], whole.values["y"])
    without = run(checkpoint=tmp_path / "c")  # not asked for: the file keeps them all the same
    assert without.values is None and without.mean == whole.mean and without.yield_ == whole.yield_
    np.testing.assert_array_equal(run(checkpoint=tmp_path / "c", keep=True).values["y"], whole.values["y"])


def test_parquet_holds_the_same_bits_with_units_seed_and_versions(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    pytest.importorskip("pandas", reason="the extra parquet is not installed")
    about = dict(errors=True, units={"y": "rad", "a": "m"})
    run(save=UnitFile(tmp_path / "u.csv", **about))
    run(save=UnitFile(tmp_path / "u.parquet", **about, about={"name": "product"}))
    found, table = tolerances.load(tmp_path / "u.parquet"), rows(tmp_path / "u.csv")
    assert list(found) == ["status", "y", "z", "a", "b[0,0]", "b[0,1]", "b[1,0]", "b[1,1]"]
    np.testing.assert_array_equal(found["b[1,0]"], [float(row["b[1,0]"]) for row in table])
    np.testing.assert_array_equal(found["y"], [float(row["y [rad]"] or "nan") for row in table])
    assert list(found["status"]) == [row["status"] for row in table] and found.index.name == "unit"
    assert found.attrs["units"] == {"y": "rad", "a": "m"} and found.attrs["seed"] == 3
    origin = tolerances.origin(tmp_path / "u.parquet")
    assert origin.kind == "units" and origin.seed == 3 and origin.study["name"] == "product"
    assert origin.versions == versions() and origin.study["method"] == "random"
    file = parquet.ParquetFile(tmp_path / "u.parquet")
    assert [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)] == [100, 100, 50]
    (tmp_path / "bad.parquet").write_bytes(b"PAR1 no table PAR1")
    with pytest.raises(ValueError, match=r"bad\.parquet: damaged, or no result of rvjax"):
        tolerances.load(tmp_path / "bad.parquet")


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize("processes", [2, 4])
def test_parts_of_several_processes_make_one_table(tmp_path, ending, processes):
    """Two processes with two chunks and one, or four of which one has none."""
    if ending == ".parquet":
        pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    run(save=tmp_path / f"whole{ending}")
    parts = [tmp_path / f"u{ending}.{k}-of-{processes}" for k in range(processes)]
    target = UnitFile(tmp_path / f"u{ending}")
    values = run(keep=True).values
    for k, part in enumerate(parts):
        with unit_file.writing(target, part, ("y", "z"), Population.of(ERRORS), {}) as write:
            for number in Chunks.up_to(3).share(k, processes):
                units = slice(100 * number, min(100 * number + 100, 250))
                cut = {name: column[units] for name, column in values.items()}
                status = np.where(np.isnan(cut["y"]), int(Status.SINGULAR), int(Status.CONVERGED))
                write(units.start, cut, status, {})
    unit_file.joined(parts, tmp_path / f"u{ending}")
    assert not any(part.exists() for part in parts)
    if ending == ".csv":
        assert (tmp_path / "u.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    else:
        parquet = pytest.importorskip("pyarrow.parquet")
        one, other = (parquet.read_table(tmp_path / f"{name}.parquet") for name in ("u", "whole"))
        assert repr(one.to_pydict()) == repr(other.to_pydict())


def test_an_interrupted_run_leaves_no_half_table(tmp_path, monkeypatch):
    def interrupted(self, first):
        raise KeyboardInterrupt

    (tmp_path / "u.csv").write_text("older")
    monkeypatch.setattr(Evaluator, "errors", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(save=UnitFile(tmp_path / "u.csv", errors=True))
    assert [file.name for file in tmp_path.iterdir()] == ["u.csv"] and (tmp_path / "u.csv").read_text() == "older"


def test_an_impossible_table_is_an_error_before_any_unit_is_solved(tmp_path, monkeypatch, capsys):
    with pytest.raises(ValueError, match=r"u\.txt: must end with \.csv or \.parquet"):
        UnitFile(tmp_path / "u.txt")
    target = UnitFile(tmp_path / "u.csv", errors=True)
    with pytest.raises(ValueError, match=r"u\.csv: two columns would be called a; rename the response"):
        monte_carlo(lambda e: {"a": e["a"]}, ERRORS, save=target, **OPTIONS)
    with pytest.raises(FileNotFoundError):
        run(save=tmp_path / "no" / "u.csv")
    for package in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=r"u\.parquet needs pyarrow: pip install 'rvjax\[parquet\]'"):
        run(save=tmp_path / "u.parquet")
    monkeypatch.chdir(tmp_path)
    assert cli.main(["montecarlo", "rv-40e", "--quiet", "--save", "u.parquet"]) == 2
    assert "u.parquet needs pyarrow" in capsys.readouterr().err
    for options in (["--save-errors"], ["--save-errors", "--save", "u.npz"]):
        assert cli.main(["montecarlo", "rv-40e", "--quiet", *options]) == 2
        assert "--save-errors: needs --save FILE" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
