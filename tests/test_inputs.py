"""A few of the 500 mutated studies and CSV files of `benchmarks.census.inputs`: each ends as a command should."""

import numpy as np
import pytest

from benchmarks.census import inputs


@pytest.mark.long  # the sound ones run below, and each bad input has its own test
def test_a_mutated_input_ends_with_one_line():
    counts, wrong = inputs.run(studies=24, files=16, seed=7, commands=("check", "compensate"))
    assert wrong == []
    assert sum(counts.values()) == 11 and {"check 2", "compensate 2", "compensate 0"} <= set(counts)


def test_mutations_change_the_files_and_the_sound_ones_pass(tmp_path, monkeypatch):
    random = np.random.default_rng(0)
    studies = {inputs.mutated_study(inputs.STUDY, random) for _ in range(50)}
    files = {inputs.mutated_file(inputs.CURVE, random) for _ in range(50)}
    assert min(len(studies), len(files)) > 45
    monkeypatch.chdir(tmp_path)
    for name, text in {"study.toml": inputs.STUDY, "curve.csv": inputs.CURVE}.items():
        (tmp_path / name).write_text(text)
    assert inputs.ends(["check", "study.toml"])[0] == 0
    assert inputs.ends(["compensate", "study.toml", "curve.csv", "--quiet"]) == (0, [], "")


def test_a_fault_is_seen(monkeypatch):
    """A traceback, another exit code, two lines, no end."""
    from rvjax import cli

    def fails(_arguments):
        raise KeyError("x")

    def two_lines(_arguments):
        import sys

        print("rvjax: error: a\nb", file=sys.stderr)
        return 2

    def endless(_arguments):
        while True:
            pass

    for main, word in ((fails, "KeyError"), (lambda _: 3, "exit code 3"), (two_lines, "2 lines"), (endless, "no end")):
        monkeypatch.setattr(cli, "main", main)
        assert word in inputs.ends([], limit=0.2)[2]
