"""`rvjax/_jax`, which leans on internals of JAX, on the newest JAX that `pyproject.toml` allows. A job of the workflow.

The newest CPython on the path gets a virtual environment and the newest packages; the tests of `_jax` run there as they
are. A newer JAX may need a newer Python than the one that runs this file.
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
NEEDED = ("pytest", "pytest-xdist", "hypothesis", "mpmath")  # others of `dev` might hold JAX back
BY_PUBLIC_NAMES = ("arguments", "arguments_elsewhere", "compiled_once", "loaded_batches", "only_required_outputs")


def files_of_jax():
    """Test files that import `rvjax._jax`, and those that reach it through public names."""
    files = [path for path in (ROOT / "tests").rglob("test_*.py") if path != Path(__file__)]
    named = {f"test_{name}" for name in BY_PUBLIC_NAMES}
    found = [path for path in files if path.stem in named or "rvjax._jax" in path.read_text("utf-8")]
    assert named < {path.stem for path in found}
    return sorted(str(path.relative_to(ROOT)) for path in found)


def newest_python():
    """The highest version of CPython on the path that starts; else this one."""
    for minor in range(sys.version_info.minor + 9, sys.version_info.minor, -1):
        path = shutil.which(f"python3.{minor}")
        if path and subprocess.run([path, "-m", "venv", "--help"], capture_output=True, check=False).returncode == 0:
            return path
    return sys.executable


@pytest.mark.long
def test_what_leans_on_jax_passes_on_the_newest_version(tmp_path, capsys):
    ours = ("JAX_", "XLA_", "TF_", "PYTHON", "PYTEST_", "HYPOTHESIS_")  # set for this JAX and this profile
    plain = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    python = tmp_path / "venv" / ("Scripts" if os.name == "nt" else "bin") / "python"

    def run(*command):
        done = subprocess.run(command, cwd=ROOT, env=plain, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout.strip()

    run(newest_python(), "-m", "venv", tmp_path / "venv")
    run(python, "-m", "pip", "install", "-q", "--upgrade", "--no-compile", "-e", ROOT, *NEEDED)
    asked = "import sys, jax; print('JAX', jax.__version__, 'on Python', sys.version.split()[0])"
    version = run(python, "-c", asked)
    with capsys.disabled():
        print(f"\n{version}", flush=True)
    said = run(python, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", *files_of_jax())
    with capsys.disabled():
        print(said.splitlines()[-1])
