"""Lint and format of the whole tree; types, which take one core half a minute, are a job of the workflow."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(("mypy",), id="types", marks=pytest.mark.long),
        pytest.param(("ruff", "check", "."), id="lint"),
        pytest.param(("ruff", "format", "--check", "."), id="format"),
    ],
)
def test_the_code_is_clean(command):
    """As on the command line, by the settings in pyproject.toml."""
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


TYPED = ("assembly", "cli", "commands", "compensation", "dynamics", "four_bar", "identify", "lost_motion", "mesh_force")
TYPED += ("outputs", "plotting", "progress", "render", "study", "tolerances", "units")
"""Layers whose signatures name what they take and return."""


@functools.cache
def annotations(path):
    """Of every parameter and result of every function of a file."""
    found = []
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            given = node.args
            every = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            found += [one.annotation for one in every if one is not None and one.annotation is not None]
            found += [] if node.returns is None else [node.returns]
    return found


ANY = {"Any", "Cell", "PyTree"}
"""`Any` and its other names."""


def says_any(annotation):
    return any(isinstance(node, ast.Name) and node.id in ANY for node in ast.walk(annotation))


@pytest.mark.long  # parses the whole package, as mypy does, which is a job
@pytest.mark.parametrize(("layers", "most"), [(TYPED, 0.06), (("*",), 0.03)], ids=["typed layers", "everything"])
def test_few_signatures_say_any(layers, most):
    """`Any` tells an editor nothing; a named type or `object` does."""
    package = ROOT / "rvjax"
    files = [
        path
        for path in package.rglob("*.py")
        if {path.relative_to(package).parts[0].removesuffix(".py"), "*"} & {*layers}
    ]
    found = [says_any(annotation) for path in files for annotation in annotations(path)]
    assert len(found) > 500 and sum(found) <= most * len(found), f"{sum(found)} of {len(found)}"
