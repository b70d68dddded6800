"""Every notebook runs from an empty namespace with shrunk sizes, and what is stored of it is small and clean.

The oracle stands in the notebooks: their cells assert what their text claims. One kernel serves all: before each it
forgets every name and goes back to single precision, and what one notebook compiled the next one finds. It shows what a
reader gets, inline pictures and output streams included.
"""

import re
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long  # a job of the workflow; its packages are imported where they are used

FOLDER = Path(__file__).parents[2] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
LARGEST = 400_000  # bytes


def outputs(notebook):
    return [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]


def pictures(notebook):
    return sum("image/png" in output.get("data", {}) for output in outputs(notebook))


@pytest.fixture(scope="module")
def kernel(tmp_path_factory):
    """A running kernel of this environment, whatever kernels the user has installed."""
    from jupyter_client import KernelManager

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RVJAX_SMALL", "1")
        patch.setenv("PYTHONPATH", str(FOLDER.parent))
        patch.setenv("IPYTHONDIR", str(tmp_path_factory.mktemp("ipython")))
        patch.setenv("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA notes every program that it takes from the cache
        patch.delenv("MPLBACKEND", raising=False)
        manager = KernelManager()
        manager.kernel_spec.argv[0] = sys.executable
        manager.start_kernel()
    yield manager
    manager.shutdown_kernel(now=True)


def run_in(kernel, notebook):
    from nbclient import NotebookClient

    client = NotebookClient(notebook, km=kernel, timeout=300)
    with client.setup_kernel(cleanup_kc=False):  # which would take the kernel along
        try:
            for index, cell in enumerate(notebook.cells):
                client.execute_cell(cell, index)
        finally:
            client.kc.stop_channels()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs_shrunk(path, tmp_path, kernel):
    import nbformat

    notebook = nbformat.read(path, as_version=4)
    drawn = pictures(notebook)
    work = tmp_path / "work"
    work.mkdir()
    fresh = f"%reset -f\nimport os, jax, matplotlib\nos.chdir({str(work)!r})\n"
    fresh += "jax.config.update('jax_enable_x64', False)\nmatplotlib.rcdefaults()\n%matplotlib inline\n%reset -f"
    run_in(kernel, nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(fresh)]))
    run_in(kernel, notebook)
    said = [output.text for output in outputs(notebook) if output.get("name") == "stderr"]
    assert said == [] and pictures(notebook) > 0 and pictures(notebook) <= drawn
    assert list(work.iterdir()) == []  # nothing is left behind


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_is_stored_small_clean_and_with_its_pictures(path):
    import nbformat

    assert path.stat().st_size < LARGEST
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert 8 <= len(notebook.cells) <= 24 and notebook.metadata.kernelspec.name == "python3"
    assert set(notebook.metadata.language_info) == {"name"}  # no version of Python that changes with every run
    assert notebook.cells[0].cell_type == "markdown" and "**Question:**" in notebook.cells[0].source
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in code] == list(range(1, len(code) + 1))
    assert pictures(notebook) >= 3 and pictures(nbformat.v4.new_notebook(cells=code[:3])) >= 1
    for output in outputs(notebook):
        assert output.output_type != "error" and output.get("name") != "stderr"
        text = output.get("text", "") + str(output.get("data", {}).get("text/plain", ""))
        assert not re.search(r"(?<![\w.])/(home|root|work|tmp|usr|opt|Users)\b|Traceback|[A-Z]:\\\\", text), text


def test_all_twelve_are_here():
    assert [path.name[:2] for path in NOTEBOOKS] == [f"{number:02d}" for number in range(1, 13)]
    listed = (FOLDER / "README.md").read_text()
    assert all(path.name in listed for path in NOTEBOOKS)
