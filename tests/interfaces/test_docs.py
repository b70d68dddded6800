"""The docs: every Python block of every page runs, what the blocks state is asserted in them, the build has no warning.

The pages that compile least are tested by default; all of them, and the build, are a job of the workflow. The drawings
are held against the numbers that they show.
"""

import dataclasses
import os
import re
import shlex
import subprocess
import sys
import textwrap
import types
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path as Outline

from benchmarks import tables
from rvjax import catalogue, cli, models, published, study
from rvjax.commands.init import written
from rvjax.cycloidal import CycloidalErrors
from rvjax.designs import RVReducer
from rvjax.errors import read_by
from rvjax.plotting import drawings, drive
from rvjax.units import mm, um

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(path.relative_to(DOCS) for path in DOCS.rglob("*.md") if not str(path.relative_to(DOCS)).startswith("_"))


def blocks(page, language):
    pattern = rf"^( *)```{language}\n(.*?)^\1```"
    found = re.findall(pattern, (DOCS / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)
    return [textwrap.dedent(text) for _, text in found]


# The tests of what the other pages show ask the same. A job of the workflow runs all on every push.
QUICK = ("compensation.md", "speed.md")
RUN = [page for page in PAGES if blocks(page, "python") and page.name != "add_a_model.md"]  # below, with its study
assert {str(page) for page in RUN} >= {*QUICK}


@pytest.mark.parametrize(
    "page", [pytest.param(page, marks=[] if str(page) in QUICK else [pytest.mark.long]) for page in RUN], ids=str
)
def test_the_python_of_a_page_runs(page):
    """One namespace for a page, top to bottom, as a reader would type it."""
    namespace = {"__name__": "docs"}
    for code in blocks(page, "python"):
        exec(compile(code, str(page), "exec"), namespace)


@pytest.mark.long
def test_the_python_of_the_readme_runs(capsys):
    for code in blocks("../README.md", "python"):
        exec(compile(code, "README.md", "exec"), {})
    assert len(capsys.readouterr().out.splitlines()) >= 2


def test_the_tables_are_those_of_the_code():
    """`python -m benchmarks.tables` writes a page for every kind of reducer; the contents list all pages."""
    assert set(tables.NAMES) == set(models.kinds())
    kept = {path.name: path.read_text("utf-8") for path in tables.FOLDER.glob("*.md")}
    assert kept == tables.pages()
    contents = (DOCS / "index.md").read_text("utf-8")
    assert all(f"\ntables/{name.removesuffix('.md')}\n" in contents for name in kept)


def test_the_page_of_studies_names_every_part():
    page = (DOCS / "study.md").read_text("utf-8")
    parts = [f.name for f in dataclasses.fields(RVReducer) if f.metadata["kind"] == "record"]
    assert "contact" in parts and not [part for part in parts if f"`{part}`" not in page]


def test_the_study_of_the_docs_is_a_study():
    text, _ = blocks("study.md", "toml")
    question = study.parse_study(text, name="docs", solve=False)
    assert question.design.cycloid.eccentricity == pytest.approx(1.25e-3)
    assert list(question.costs) == ["crank_eccentricity"] and list(question.requirements) == ["transmission_error"]


def test_the_drawing_of_the_docs_gives_a_study(tmp_path):
    _, drawing = blocks("study.md", "toml")
    (tmp_path / "drawing.toml").write_text(drawing)
    question = study.parse_study(written(str(tmp_path / "drawing.toml")).text, name="docs", solve=False)
    assert question.design.ratio == 121 and question.conditions.rated_torque == 784 and "life" in question.requirements


@pytest.mark.long  # test_models.py has a model of one package and one line
def test_the_study_of_the_new_model_is_a_study(monkeypatch):
    """Of the model that the page builds, as a package and one line; its twist is that of the page.

    The blocks of the page run here and not above, where they would be compiled again.
    """
    module = types.ModuleType("key_joint.outputs")
    for code in blocks("add_a_model.md", "python"):
        exec(compile(code, "add_a_model.md", "exec"), vars(module))
    monkeypatch.setitem(sys.modules, "key_joint", types.ModuleType("key_joint"))
    monkeypatch.setitem(sys.modules, "key_joint.outputs", module)
    monkeypatch.setattr(models, "MODELS", (*models.MODELS, "key_joint"))
    (text,) = blocks("add_a_model.md", "toml")
    question = study.parse_study(text, name="docs")
    assert list(question.costs) == ["key_width", "slot_width"] and question.doubts == []
    errors = module.KeyErrors(key_width=-10 * um, slot_width=10 * um)
    found = question.response()(errors).value["twist"]
    assert float(found) == float(module.twist(errors, torque=500.0).angle)


def test_the_first_study_of_the_first_page_is_a_study(thorough):
    (text,) = blocks("index.md", "toml")
    question = study.parse_study(text, name="docs", solve=thorough)
    assert question.doubts == [] and list(question.costs) == ["crank_eccentricity"]


def test_every_key_of_a_study_is_explained():
    text = (DOCS / "study.md").read_text("utf-8")
    keys = ["lower", "upper", "half_width", "grade", "size", "distribution", "cp", "shift", "batch", "beta", "model"]
    keys += ["fixed", "scale", "finest", "coarsest", "reference", "power", "decay", "response", "target", "base"]
    keys += ["cost", "per", "price", "at", "seed", "samples", "certificate_samples"]
    for key in keys:
        assert f"`{key}`" in text, key
    for table in (
        "accuracy",
        "assembly",
        "conditions",
        "cost",
        "design",
        "[duty]",
        "loss",
        "requirement",
        "run",
        "tolerances",
    ):
        assert f"## `[{table}" in text, table


def test_the_commands_of_the_docs_exist(capsys):
    text = "".join((DOCS / page).read_text("utf-8") for page in PAGES)
    for command in sorted(
        set(
            re.findall(
                r"rvjax (allocate|report|montecarlo|reproduce|tradeoff|assemble|compensate|[a-z]+ --(?!>))", text
            )
        )
    ):
        assert cli.main([command, "--help"]) == 0
    assert "examples:" in capsys.readouterr().out


@pytest.mark.long
def test_the_first_commands_of_the_readme_run(tmp_path, monkeypatch, capsys):
    """One for each kind of user, with the studies of the pages that the table names."""
    monkeypatch.chdir(tmp_path)
    Path("joint.toml").write_text(blocks("friction.md", "toml")[0], "utf-8")
    Path("bench.toml").write_text(blocks("identify_bench.md", "toml")[0], "utf-8")
    table = (DOCS.parent / "README.md").read_text("utf-8").split("| user |")[1].split("\n\n")[0]
    first = [re.search(r"`rvjax (.+?)`", row.split("|")[2]).group(1) for row in table.splitlines()[2:]]
    assert [command.split()[0] for command in first] == ["init", "init", "export", "identify"]
    for command in first:
        assert cli.main(shlex.split(command)) == 0, command
    assert {"mine.toml", "drive.toml", "joint.json"} <= {path.name for path in tmp_path.iterdir()}
    assert "Measure next" in capsys.readouterr().out


@pytest.mark.long  # compiles an allocation
def test_the_new_model_is_allocated_in_a_new_process(tmp_path):
    """With the script of the page; the command of rvjax itself names the kinds that it has."""
    (start,), (text,) = blocks("add_a_model.md", "py"), blocks("add_a_model.md", "toml")
    package = tmp_path / "key_joint" / "outputs.py"
    package.parent.mkdir()
    package.write_text("\n\n".join(blocks("add_a_model.md", "python")[:3]), "utf-8")
    (tmp_path / "start.py").write_text(start, "utf-8")
    (tmp_path / "key.toml").write_text(text, "utf-8")
    env = os.environ | {"PYTHONPATH": str(DOCS.parent), "JAX_PLATFORMS": "cpu"}
    for command, code, words in (
        (["start.py", "check", "key.toml"], 0, "No warnings"),
        (["start.py", "allocate", "key.toml", "--quiet"], 0, "Study key: OPTIMAL"),
        (["-m", "rvjax", "check", "key.toml"], 2, "design.kind = 'key-joint': must be one of rv,"),
    ):
        done = subprocess.run(
            [sys.executable, *command], cwd=tmp_path, env=env, capture_output=True, text=True, check=False
        )
        assert done.returncode == code and words in done.stdout + done.stderr, done.stderr


@pytest.mark.long
def test_the_build_has_no_warning(tmp_path):
    sphinx = "import gc, sys; gc.disable(); from sphinx.cmd.build import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", sphinx, "-W", "-n", "-q", "--keep-going", "-d", tmp_path / "doctrees"]
    quiet = os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3"}
    done = subprocess.run([*command, DOCS, tmp_path / "html"], capture_output=True, text=True, check=False, env=quiet)
    assert done.returncode == 0, done.stderr
    for page in PAGES:
        html = (tmp_path / "html" / page.with_suffix(".html")).read_text("utf-8")
        assert not re.search(r'src="(https?:)?//', html)  # equations and all else without a network
    assert "<math" in (tmp_path / "html" / "models" / "four_bar.html").read_text("utf-8")
    reproduce = (tmp_path / "html" / "reproduce.html").read_text("utf-8")
    for source in published.SOURCES:
        for figure in published.figures(source):
            assert figure["id"] in reproduce
            # The page shows the ledger's values: `test_published` holds these against computed ones.
            shown = published.compare(figure, published.ours(figure))
            assert shown.status == figure["expected_status"], figure["id"]
    levels = (tmp_path / "html" / "levels.html").read_text("utf-8")
    assert "closed form, 64 angles, float64" in levels and "_images/tradeoff.png" in levels
    api = (tmp_path / "html" / "api" / "four_bar.html").read_text("utf-8")
    assert 'id="rvjax.four_bar.revolution"' in api and "output_torque" in api


@pytest.fixture
def axes():
    yield plt.subplots()[1]
    plt.close("all")


def test_the_drawn_disc_touches_the_pins_and_enters_none(axes):
    design = catalogue.RV_40E
    drawings.reducer(design, crank_angle=0.7, axes=axes)
    disc = next(line for line in axes.lines if line.get_label() == "disc 0").get_xydata() * mm
    pins = np.array([patch.center for patch in axes.patches[: design.cycloid.pin_count]]) * mm
    gaps = np.linalg.norm(disc[None] - pins[:, None], axis=-1).min(axis=1) - design.cycloid.pin_radius
    # The flank conjugate to the pins touches all of them; drawn with 60 points for each tooth.
    assert gaps.min() > -2e-6 and gaps.max() < 20e-6


def test_drawn_discs_of_a_drive_touch_pins_of_ring_and_carrier(axes):
    free = catalogue.CYCLOIDAL_17
    design = free.replace(output=free.output.replace(hole_clearance=0.0))
    drive.reducer(design, axes=axes)
    pins = [np.array(patch.center) * mm for patch in axes.patches if isinstance(patch, Circle)]
    ring, output = (
        np.array([at for at in pins if np.isclose(np.hypot(*at), radius)])
        for radius in (design.cycloid.pin_circle_radius, design.output.circle_radius)
    )
    assert len(ring) == 18 and len(output) == 6
    outlines = [p for p in axes.patches if isinstance(p, PathPatch) and not p.get_fill()]
    assert len(outlines) == 2
    for disc in outlines:
        drawn = disc.get_path().codes != Outline.CLOSEPOLY
        at, codes = disc.get_path().vertices[drawn] * mm, disc.get_path().codes[drawn]
        parts = np.split(at, np.flatnonzero(codes == Outline.MOVETO)[1:])
        flank, holes = parts[0], parts[1:-1]
        gaps = np.linalg.norm(flank - ring[:, None], axis=-1).min(axis=1) - design.cycloid.pin_radius
        assert gaps.min() > -2e-6 and gaps.max() < 20e-6  # drawn with 60 points for each tooth
        for hole, pin in zip(holes, output):  # without clearance every pin touches its hole from inside
            gap = np.linalg.norm(hole - pin, axis=-1).min() - design.output.pin_radius
            assert -2e-6 < gap < 20e-6


@pytest.mark.parametrize("name", ["CYCLOIDAL_15", "CYCLOIDAL_17", "CYCLOIDAL_29"])
def test_the_picture_of_a_drive_has_every_error_at_its_part(axes, name):
    """Arrows end on a pin of the ring, on an output pin, on the edge of a hole, and on the flank."""
    design = getattr(catalogue, name)
    drive.errors(design, axes=axes)
    texts = {text.get_text(): np.array(text.xy) * mm for text in axes.texts}
    named = [line.split()[0] for text in texts for line in text.split("\n")]
    geometric = read_by(CycloidalErrors, "loaded")
    assert [one for one in geometric if named.count(one) != 1] == []
    at = {part: texts[part] for part in ("pin", "output pin", "hole", "flank", "eccentric")}
    cycloid, output = design.cycloid, design.output
    pins = [np.array(patch.center) * mm for patch in axes.patches if isinstance(patch, Circle) and patch.radius > 0]
    assert min(np.hypot(*(at["pin"] - pin)) for pin in pins) < 1e-9
    assert np.hypot(*at["pin"]) == pytest.approx(cycloid.pin_circle_radius)
    assert min(np.hypot(*(at["output pin"] - pin)) for pin in pins) < 1e-9
    assert np.hypot(*at["output pin"]) == pytest.approx(output.circle_radius)
    assert at["eccentric"] == pytest.approx([cycloid.eccentricity, 0])
    angle = 2 * np.pi * np.arange(output.count) / output.count
    holes = output.circle_radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) + at["eccentric"]
    radius = output.pin_radius + cycloid.eccentricity + output.hole_clearance / 2
    assert np.abs(np.hypot(*(holes - at["hole"]).T) - radius).min() < 1e-9
    ring = np.array([pin for pin in pins if np.isclose(np.hypot(*pin), cycloid.pin_circle_radius)])
    assert np.hypot(*(ring - at["flank"]).T).min() > cycloid.pin_radius - 2e-6


def test_the_drawn_linkage_is_a_parallelogram_in_the_frames_of_its_cranks(axes):
    drawings.linkage(catalogue.RV_40E, crank_angle=1.0, axes=axes)
    lines = {line.get_label(): line.get_xydata() for line in axes.lines}
    carrier, disc = lines["carrier (frame)"], lines["disc (coupler)"]
    np.testing.assert_allclose(np.diff(carrier, axis=0), np.diff(disc, axis=0))
    assert carrier[0, 0] == -36.0 and np.diff(carrier, axis=0)[0, 0] == 72.0  # crank 0 on the negative x axis
    arm = disc[0] - carrier[0]
    assert np.arctan2(arm[1], arm[0]) == pytest.approx(1.0)


def test_the_discs_before_and_after_are_drawn_as_wide_as_they_are():
    before = study.load("rv-40e-design", solve=False)
    after = before.design_with({"contact.face_width": 9 * mm})
    figure = drawings.before_and_after(before.design, after).figure
    sides = figure.axes[2:]
    for axes, width in zip(sides, (12.0, 9.0)):
        discs = [patch for patch in axes.patches if patch.get_fill()]
        assert [disc.get_height() for disc in discs] == pytest.approx(2 * [width])
        assert discs[1].get_y() > discs[0].get_y() + width  # beside each other
        apart = discs[0].get_x() - discs[1].get_x()
        assert apart == pytest.approx(2 * 1.3)  # opposed eccentricities
    plain = drawings.before_and_after(catalogue.RV_40E, catalogue.RV_40E).figure  # has no width
    assert len(plain.axes) == 2
    plt.close("all")
