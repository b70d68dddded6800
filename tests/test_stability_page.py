"""The page on stability: its census is that of the file, and a small one of other inputs finds the same: nothing.

Oracle: benchmarks/census/census.json for the page; the judges of the census for the inputs, and float64 for float32 on
numbers that float32 holds exactly. The bounds are read from the page, so that they are stated once.
"""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

from benchmarks.census import one_model, table
from benchmarks.census.cases import spoiled
from benchmarks.census.models import models
from rvjax import Status

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "stability.md").read_text()
BOUNDS = {name: float(bound) for name, bound in re.findall(r"^\| (\w+ \w+) \| (\d+e-\d+) \|", PAGE, re.MULTILINE)}


def test_the_pages_show_the_census_of_the_file():
    """All tables in benchmarks/census/NOTES.md, outcomes without statuses on the page."""
    file = table.stored()
    for page, due in table.pages(file).items():
        assert page.read_text().split(table.BEGIN)[1].split(table.END)[0].strip() == due.strip()
    groups = {entry["group"] for entry in file["census"]}
    assert {group for group in groups if not group.startswith("dynamics")} == set(BOUNDS)  # the page says why


SMALL = [  # a job of the workflow, one of every group; test_extremes.py has random inputs of each model by default
    "four_bar linkage free open closed_form",
    "lost_motion closed_form 39 teeth",
    "mesh_force linear 2 teeth",
    "loaded hertz 3 cranks 2 discs 24 teeth carrier floating",
    "four_bar reducer 2 cranks 1 discs",
    "lost_motion first_order 39 teeth",
    "lost_motion contact 39 teeth",
    "mesh_force hertz 2 teeth",
    "mesh_force palmgren 2 teeth",
    "loaded linear 4 cranks 3 discs 24 teeth carrier floating sun floating given stiffness",
    "loaded palmgren 2 cranks 2 discs 39 teeth",
    "dynamics errors 3 cranks 3 discs",
]


@pytest.mark.long
@pytest.mark.parametrize("name", SMALL)
def test_a_small_census_is_clean(name):
    """Two thousand fresh inputs (five hundred of a whole reducer), other ones than those of the file: statuses,
    finiteness, float32, derivatives."""
    inputs = 512 if name.startswith("loaded") else 2048
    sizes = one_model.Sizes(inputs, inputs, max(64, inputs // 8))
    # The census's own arithmetic beside the models promotes as NumPy does.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"), np.errstate(all="ignore"):
        model = next(m for m in models() if m.name == name)
        entry = one_model.census(model, inputs, seed=7, until=np.inf, progress=lambda _: None, sizes=sizes)
    for figure in ("silent", "finite where NaN is due", "wrong status", "float32 silent", "poisoned gradients"):
        assert entry[figure] == 0, figure
    assert entry["statuses"]["CONVERGED"] > 200 and len(entry["statuses"]) > 1 and entry["derivatives"] > 0
    worst = {figure: item["figure"] for figure, item in entry["worst"].items()}
    assert worst.get("residual", 0) <= 1e-10
    assert 0 < worst["float32"] <= BOUNDS.get(model.group, np.inf)  # zero: nothing was compared


@pytest.mark.long  # hostile designs run in test_dynamics_error.py by default
def test_a_few_dynamic_errors_are_clean():
    """Statuses and finiteness of 512 reducers, and the lines of those that the judge's own sums tell to 1e-6."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"), np.errstate(all="ignore"):
        model = next(m for m in models() if m.name == "dynamics errors 2 cranks 2 discs")
        rng = np.random.default_rng(8)
        case = spoiled(model.draw(rng, 512), rng)
        out = jax.tree.map(np.asarray, jax.jit(jax.vmap(model.run))(case))
        due, error = model.judge(case, out)
    status = out["status"]
    assert (status[due >= 0] == due[due >= 0]).all() and (due == Status.CONVERGED).sum() >= 5
    kept = np.isin(status, one_model.KEPT)
    assert all((np.isfinite(value).reshape(512, -1).all(1) == kept).all() for value in out["values"])
    held = case["sun_torsion"] + case["output_torsion"] > 0
    assert error[held].max() < 1e-6 and (error[held] > 0).any() and {Status.CONVERGED, Status.NONFINITE} <= set(status)
