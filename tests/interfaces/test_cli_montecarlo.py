"""`rvjax montecarlo` from end to end on a study that compiles fast.

Oracle: `monte_carlo` on the same study in this process, to the last bit.
"""

import dataclasses
import json
from importlib import resources

import jax
import numpy as np
import pytest

from rvjax import cli, commands, study
from rvjax.commands.montecarlo import batch
from rvjax.tolerances import load, monte_carlo, origin

GOOD = (resources.files("rvjax.study") / "embedded" / "rv-40e.toml").read_text("utf-8")
HEAD, *REQUIREMENTS = GOOD.partition("[requirement.transmission_error]")
CONDITIONS = HEAD[HEAD.index("[conditions]") : HEAD.index("[tolerances.")]  # lost motion reads none of them
SMALL = HEAD.replace(CONDITIONS, "") + REQUIREMENTS[-1][REQUIREMENTS[-1].index("[requirement.lost_motion]") :]


JOINED = ["--distributed", "--checkpoint", "c"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    return tmp_path


@pytest.fixture(scope="module")
def expected():
    question = study.parse_study(SMALL, name="small")
    arguments = dict(samples=5000, seed=4, chunk=1000, requirements=question.requirements, keep=True)
    return monte_carlo(question.response(), question.tolerances, **arguments)


def assert_same(found, expected):
    """Every figure and every unit, to the last bit."""
    one, two = (repr(dataclasses.replace(each, values=None, study={})) for each in (found, expected))
    assert one == two
    for name, values in expected.values.items():
        np.testing.assert_array_equal(found.values[name], values)


def test_a_batch_prints_and_writes_its_figures(here, capsys, expected):
    command = "montecarlo small.toml --samples 5e3 --seed 4 --chunk 1000 --json a.json --save a.npz --checkpoint c"
    assert cli.main([*command.split(), "--quiet"]) == 0
    printed = capsys.readouterr()
    for words in (
        "Study small: 5,000 units, method random, seed 4",
        "lost_motion",
        "arcmin",
        "0 failed",
        "independent",
    ):
        assert words in printed.out
    assert printed.err == ""
    found = load("a.npz")
    np.testing.assert_array_equal(found.values["lost_motion"], expected.values["lost_motion"])
    written = json.loads((here / "a.json").read_text())
    assert written["result"]["fields"]["values"] is None
    assert origin("a.json").study["toml"] == SMALL and origin("a.json").seed == 4
    mean = expected.mean["lost_motion"].value
    assert load("a.json").mean["lost_motion"].value == mean
    assert f"{mean / 2.908882086657216e-4:.5g}" in printed.out
    assert cli.main([*command.split(), "--quiet", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["mean"]["lost_motion"]["value"] == mean and told["units"] == {"lost_motion": "rad"}
    assert told["values"] is None and told["name"] == "small" and told["yield_"]["lost_motion"]["lower"] > 0


@pytest.mark.long  # test_cli_distributed.py has threads in the place of processes
def test_two_processes_on_one_machine(here, capfd, expected):
    command = "montecarlo small.toml --samples 5000 --seed 4 --chunk 1000 --processes 2 --checkpoint c --save a.npz"
    code, said = cli.main(command.split()), capfd.readouterr().err
    assert code == 0, said
    assert "process 1 of 2" in said and "process 2 of 2" not in said
    assert sorted(file.name for file in here.iterdir()) == ["a.npz", "c", "small.toml"]
    assert_same(load("a.npz"), expected)
    (here / "a.npz").unlink()
    assert cli.main([*command.replace("--processes 2", "--quiet").split()]) == 0  # nothing is left to count
    assert_same(load("a.npz"), expected)


@pytest.mark.long
def test_a_process_that_fails_ends_the_others(here):
    (here / "c.1-of-2").write_text("damaged")
    with pytest.raises(ValueError, match=r"process 1 of 2 ended with 2"):
        batch.run_in_processes(["montecarlo", "small.toml", "--samples", "5000", "--checkpoint", "c", "--quiet"], 2)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--samples", "0"], ["--samples", "'0'", "at least 1"]),
        (["--samples", "many"], ["--samples", "'many'", "whole number"]),
        (["--json", "a.txt"], ["--json a.txt", "must end with .json"]),
        (["--save", "no/a.npz"], ["--save no/a.npz", "no such folder"]),
        (["--checkpoint", "no/c", "--samples", "9"], ["no/c"]),
        (["--chunk", "1.5"], ["--chunk", "'1.5'"]),
        (["--coordinator", "a:1"], ["--coordinator", "needs --distributed"]),
        (["--distributed"], ["needs --checkpoint FILE", "all processes share"]),
        (["--distributed", "--checkpoint", "no/c"], ["--checkpoint no/c", "no such folder"]),
        ([*JOINED, "--processes", "2"], ["--processes", "--coordinator HOST:PORT"]),
        ([*JOINED, "--coordinator", "here"], ["--coordinator here", "HOST:PORT"]),
        ([*JOINED, "--coordinator", "a:1"], ["--coordinator", "--process-id K", "mpirun"]),
        ([*JOINED, "--coordinator", "a:1", "--process-id", "1"], ["--process-id 1", "0 to 0"]),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(here, capsys, arguments, words):
    before = sorted(here.rglob("*"))
    assert cli.main(["montecarlo", "small.toml", "--quiet", *arguments]) == 2
    captured = capsys.readouterr()
    message = captured.err.strip().splitlines()[-1]
    for word in words:
        assert word in message
    assert "Traceback" not in captured.err and captured.out == ""
    assert sorted(here.rglob("*")) == before


def test_an_interrupted_batch_says_how_to_go_on(here, capsys, monkeypatch):
    def interrupted(_, **how):
        raise KeyboardInterrupt

    monkeypatch.setattr(batch, "run", interrupted)
    assert cli.main(["montecarlo", "small.toml", "--checkpoint", "c"]) == 130
    assert "the same command resumes from c" in capsys.readouterr().err
    assert cli.main(["montecarlo", "small.toml"]) == 130
    assert "nothing was written" in capsys.readouterr().err


@pytest.mark.parametrize(("cores", "processes", "devices"), [(6, 1, 6), (6, 4, 1), (3, 4, 1), (64, 1, 8)])
def test_each_core_is_a_device_unless_told_otherwise(monkeypatch, cores, processes, devices):
    told = {}
    monkeypatch.setattr(jax.config, "update", told.__setitem__)
    monkeypatch.setattr(commands.os, "sched_getaffinity", lambda _: set(range(cores)), raising=False)
    monkeypatch.delenv("JAX_NUM_CPU_DEVICES")
    commands.share_cores(processes)
    assert told == {"jax_num_cpu_devices": devices}
    for name, value in (("JAX_NUM_CPU_DEVICES", "1"), ("XLA_FLAGS", "--xla_force_host_platform_device_count=2")):
        with monkeypatch.context() as patch:
            patch.setenv(name, value)
            told.clear()
            commands.share_cores(processes)
            assert not told
