"""Test configuration: float64, no silent promotion of dtype or rank, headless pictures."""

import json
from pathlib import Path

import jax
import matplotlib
import pytest

import rvjax

rvjax.enable_x64()
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
matplotlib.use("Agg")

REFERENCE = Path(__file__).parent / "reference"


@pytest.fixture(scope="session")
def reference():
    """Independent high-precision cases: reference("four_bar") is the parsed file of that model."""
    return lambda model: json.loads((REFERENCE / f"{model}.json").read_text())
