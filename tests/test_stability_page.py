"""The page on stability: its census is that of the file, its bounds of single precision hold.

Oracle: census/census.json, and the models in float64 on inputs that float32 holds exactly. The bounds are read
from the page, so that they are stated once.
"""

import re
from pathlib import Path

import jax
import numpy as np
import pytest

from census import table
from census.models import models

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "stability.md").read_text()
BOUNDS = {name: float(bound) for name, bound in re.findall(r"^\| (\w+ \w+) \| (\d+e-\d+) \|", PAGE, re.MULTILINE)}


def test_the_page_shows_the_census_of_the_file():
    file = table.stored()
    shown = PAGE.split(table.BEGIN)[1].split(table.END)[0].strip()
    assert shown == table.tables(file).strip()
    groups = {entry["group"] for entry in file["census"]}
    assert {group for group in groups if not group.startswith("dynamics")} == set(BOUNDS)  # the page says why


def test_the_census_is_clean():
    for entry in table.stored()["census"]:
        for figure in ("silent", "finite where NaN is due", "wrong status", "float32 silent"):
            assert entry[figure] == 0, (entry["model"], figure)
        assert entry["worst"].get("residual", {"figure": 0})["figure"] <= 1e-10, entry["model"]
        if entry["group"] in BOUNDS:
            assert entry["worst"].get("float32", {"figure": 0})["figure"] <= BOUNDS[entry["group"]], entry["model"]


MODELS = (
    "four_bar linkage phase_locked open closed_form",
    "four_bar linkage free open closed_form",
    "four_bar reducer 2 cranks 1 discs",
    "lost_motion first_order 39 teeth",
    "lost_motion closed_form 39 teeth",
    "mesh_force linear 2 teeth",
)


@pytest.mark.parametrize("name", MODELS)
def test_single_precision_keeps_its_bound(name):
    # The census's own arithmetic beside the models promotes as NumPy does.
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        model = next(m for m in models() if m.name == name)
        case = model.draw(np.random.default_rng(0), 2000)
        few = {k: v.astype(np.float32) for k, v in case.items()}
        run = jax.jit(jax.vmap(model.run))
        single = jax.tree.map(np.asarray, run(few))
        double = jax.tree.map(np.asarray, run({k: v.astype(np.float64) for k, v in few.items()}))
    good = (single["status"] == 0) & (double["status"] == 0) & model.ordinary(few)
    assert good.sum() > 200
    for one, other in zip(jax.tree.leaves(single["values"]), jax.tree.leaves(double["values"])):
        gap = np.abs(one - other).reshape(len(good), -1).max(1) / double["scale"]
        assert gap[good].max() <= BOUNDS[model.group]
