"""The command line as a whole: bad input, help, version, answers for machines."""

import argparse
import dataclasses
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest
from cli_study import SMALL

import rvjax
from rvjax import cli, commands, published
from rvjax.base.files import write_atomically


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["allocate", "absent.toml"], ["absent.toml", "no such study file"]),
        (["allocate", "rv-41e"], ["rv-41e", "rv-40e"]),
        (["allocate", "bad.toml"], ["bad", "tolerances.crank_phase.half_width", "5 kg", "arcmin"]),
        (["allocate", "good.toml", "--results", "taken"], ["taken", "exists"]),
        (["allocate", "folder.toml"], ["folder.toml"]),
        (["allocate", "good.toml", "--results", "good.toml/out"], ["good.toml", "not a folder"]),
        (["report", "good.toml", "--output", "page.pdf"], ["page.pdf", ".html"]),
        (["report", "good.toml", "--output", "absent/page.html"], ["absent/page.html", "no such folder"]),
        (["report", "good.toml", "--output", "taken.html"], ["taken.html", "is a folder"]),
        (["report", "good.toml", "--output", f"{'x' * 250}.html"], ["xxx", "too long"]),
        (["report", "absent.toml"], ["absent.toml", "no such study file"]),
        (["allocate", "good.toml", "--colour"], ["--colour"]),
        (["alocate"], ["alocate"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(here, capsys, arguments, words):
    (here / "bad.toml").write_text(SMALL.replace('"5 arcmin"\n\n[tolerances.disc', '"5 kg"\n\n[tolerances.disc'))
    (here / "good.toml").write_text(SMALL)
    (here / "taken").mkdir()
    (here / "taken.html").mkdir()
    (here / "folder.toml").mkdir()
    before = sorted(here.rglob("*"))
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    message = captured.err.strip().splitlines()[-1]  # argparse prints its usage first
    for word in words:
        assert word in message
    assert "Traceback" not in captured.err and captured.out == ""
    assert sorted(here.rglob("*")) == before


def test_a_folder_without_permission_is_named_and_not_its_trial_file(here, monkeypatch, capsys):
    """Also where the right to write is lost during the run; who runs the tests may write everywhere."""

    def refused(self, *_, **__):
        raise PermissionError(13, "Permission denied", str(self))

    (here / "good.toml").write_text(SMALL)
    monkeypatch.setattr(Path, "touch", refused)
    assert cli.main(["allocate", "good.toml", "--results", "mine/first", "--quiet"]) == 2
    said = capsys.readouterr().err
    assert said == f"rvjax: error: mine/first: cannot be written in {here} (Permission denied)\n"
    monkeypatch.setattr(Path, "write_bytes", refused)
    with pytest.raises(PermissionError, match=rf"page\.html: cannot be written in {here} \(Permission denied\)$"):
        write_atomically(here / "page.html", b"")


def test_version_and_module_entry():
    command = [sys.executable, "-m", "rvjax", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"rvjax {rvjax.__version__}"


def test_every_command_answers_machines(here, capsys, monkeypatch):
    """`--format json` everywhere; the older `--json` of two commands says the same."""
    for name in commands.COMMANDS:
        assert cli.main([name, "--help"]) == 0 and "--format {text,json}" in capsys.readouterr().out, name
    assert cli.main(["init", "new.toml", "--base", "rv-80e", "--format", "json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert made == {"study": "new.toml", "base": "rv-80e", "model": "loaded", "warnings": []}
    row = published.Comparison("a.b", "", 2.0, 2.0, "mm", "reproduced", "")
    monkeypatch.setattr(published, "reproduce", lambda say: [row])
    for option in (["--json"], ["--format", "json"]):
        assert cli.main(["reproduce", *option]) == 0
        assert json.loads(capsys.readouterr().out) == [row.as_json()]


def test_help_shows_every_option_for_users(capsys):
    """Only that of one of several processes has no help; argparse shows an option unless told by its constant."""
    fields = [(name, field) for name in commands.COMMANDS for field in dataclasses.fields(commands.inputs_of(name))]
    hidden = [(name, field.name) for name, field in fields if field.metadata["parser"]["help"] == argparse.SUPPRESS]
    assert hidden == [("montecarlo", "worker")] and len(fields) > 80
    assert cli.main(["montecarlo", "--help"]) == 0
    shown = capsys.readouterr().out
    assert "--processes" in shown and "worker" not in shown.lower() and "SUPPRESS" not in shown


def test_help_names_every_command(capsys):
    assert cli.main(["--help"]) == 0
    text = capsys.readouterr().out
    for words in ("allocate", "report", "compare", "montecarlo", "reproduce", "tradeoff", "exit codes", "examples"):
        assert words in text


@pytest.mark.parametrize(
    ("given", "gpu", "platforms", "default"),
    [
        (None, False, "cpu", None),
        (None, True, None, "cpu"),  # all that JAX has; what is small stays on the processor
        ("cuda", True, "cuda", None),
        ("cuda,cpu", False, "cuda,cpu", "cpu"),
        ("cpu", True, "cpu", None),
    ],
)
def test_small_work_stays_on_the_processor_unless_a_platform_is_named(monkeypatch, given, gpu, platforms, default):
    for name in ("JAX_PLATFORMS", "XLA_PYTHON_CLIENT_PREALLOCATE", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, "")  # restored afterwards
        monkeypatch.delenv(name)
    if given is not None:
        monkeypatch.setenv("JAX_PLATFORMS", given)
    try:
        importlib.import_module("rvjax.cli")._prepare(gpu=gpu)
        assert os.environ.get("JAX_PLATFORMS") == platforms
        assert jax.config.values["jax_default_device"] == default
        assert os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] == "false"
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    finally:
        jax.config.update("jax_default_device", None)


def test_memory_of_a_gpu_is_taken_in_advance_where_the_user_says_so(monkeypatch):
    monkeypatch.setenv("XLA_PYTHON_CLIENT_PREALLOCATE", "true")
    importlib.import_module("rvjax.cli")._prepare()
    assert os.environ["XLA_PYTHON_CLIENT_PREALLOCATE"] == "true"
