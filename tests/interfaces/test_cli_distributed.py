"""`rvjax montecarlo --distributed`: processes that share a run, one that dies, one that never comes.

Oracle: the same study in this process, to the last bit.
"""

import signal
import socket
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from scale_study import bits, run
from test_cli_montecarlo import SMALL, assert_same

from rvjax import cli, study
from rvjax.response import Evaluator
from rvjax.tolerances import load, monte_carlo
from rvjax.tolerances.batch.run import Run
from rvjax.tolerances.batch.shares import Chunks, Folder, take

COMMAND = ["montecarlo", "small.toml", "--samples", "9400", "--seed", "4", "--chunk", "1000"]
COMMAND += ["--checkpoint", "c", "--save", "a.npz", "--quiet"]


def free_port():
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def started(folder, code):
    """A process of its own, as a cluster starts it."""
    return subprocess.Popen(
        [sys.executable, *code], cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )


@pytest.mark.long  # three processes; threads stand for them below
def test_a_process_that_dies_ends_the_run_and_another_number_of_them_resumes(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    common = ["--distributed", "--coordinator", f"127.0.0.1:{free_port()}", "--processes", "2", "--timeout", "10"]
    both = [started(tmp_path, ["-m", "rvjax", *COMMAND, *common, "--process-id", str(k)]) for k in (0, 1)]
    until = time.monotonic() + 120
    while not list(tmp_path.glob("c.run-*/alive-1")):  # they have met; the study is not yet read
        assert time.monotonic() < until and both[1].poll() is None
        time.sleep(0.002)
    both[1].send_signal(signal.SIGKILL)
    said = both[0].communicate(timeout=120)[1]
    both[1].communicate()
    assert both[0].returncode == 2
    assert said == "rvjax: error: process 2 of 2 is missing: no sign of life for 10 s\n"
    assert (tmp_path / "c").is_file() and not (tmp_path / "a.npz").exists()
    assert cli.main(COMMAND) == 0
    assert sorted(file.name for file in tmp_path.iterdir() if "run-" not in file.name) == ["a.npz", "c", "small.toml"]
    question = study.parse_study(SMALL, name="small")
    arguments = dict(samples=9400, seed=4, chunk=1000, requirements=question.requirements, keep=True)
    assert_same(load("a.npz"), monte_carlo(question.response(), question.tolerances, **arguments))


def test_no_cluster_and_a_process_that_never_starts_are_errors_in_bounded_time(tmp_path):
    (tmp_path / "small.toml").write_text(SMALL)
    alone = [*COMMAND, "--distributed", "--timeout", "2"]
    one = [*alone, "--coordinator", f"127.0.0.1:{free_port()}", "--processes", "2", "--process-id", "0"]
    process = started(tmp_path, ["-c", f"from rvjax.cli import main\nassert main({alone}) == 2\nmain({one})"])
    lines = process.communicate(timeout=120)[1].splitlines()
    assert process.returncode == 2 and len(lines) == 2
    assert lines[0].startswith("rvjax: error: --distributed: found no Slurm, Open MPI or Kubernetes job here; start")
    assert "2 processes at 127.0.0.1:" in lines[1] and "did not all start within 2 s" in lines[1]
    assert [file.name for file in tmp_path.iterdir()] == ["small.toml"]


@pytest.mark.parametrize("number", [0, 1, 2])
def test_the_first_process_watches_all_and_all_watch_the_first(tmp_path, number):
    def waits(number):
        until = time.monotonic() + 5
        with Folder(tmp_path, number, 3, silence=0.1) as group:
            while time.monotonic() < until:
                group.check()
                time.sleep(0.01)

    silent = 0 if number else 2
    if number == 0:
        (tmp_path / "state-1").touch()  # has counted its units, and may go
    with pytest.raises(ValueError, match=rf"^process {silent + 1} of 3 is missing: no sign of life for 0 s$"):
        waits(number)
    if number == 0:  # the others hear of the third by the first
        with pytest.raises(ValueError, match=r"^process 3 of 3 is missing"):
            waits(1)
    assert (tmp_path / f"failed-{number}").read_text().startswith(f"process {silent + 1} of 3 is missing")


def test_shares_cover_the_rest_once_and_are_ranges():
    done = Chunks.of([(3, 5), (0, 1), (8, 9)])
    assert (done.count, done.stop, done.begun, list(done)) == (4, 9, 1, [0, 3, 4, 8])
    rest = done.rest(12)
    assert list(rest) == [1, 2, 5, 6, 7, 9, 10, 11]
    for processes in (1, 2, 3, 9):
        shares = [rest.share(process, processes) for process in range(processes)]
        assert Chunks.of(pair for share in shares for pair in share.ranges) == rest
        assert max(share.count for share in shares) - min(share.count for share in shares) <= 1
    assert done.plus((1, 3)).ranges == ((0, 5), (8, 9)) and done.within(Chunks.up_to(9)) and not rest.within(done)
    with pytest.raises(ValueError, match="counted twice"):
        done.plus((4, 6))


def three(folder, samples=9000, **options):
    """Figures of a run as each of three processes, which threads stand for, returns them."""

    def part(number):
        with Folder(folder / "shared", number, 3) as group:
            return run(samples, checkpoint=folder / "c", checkpoint_every=0, processes=group, **options)

    (folder / "shared").mkdir()
    with ThreadPoolExecutor(3) as threads:
        return list(threads.map(part, range(3)))


FURTHER = [pytest.param(options, marks=pytest.mark.long) for options in ({"method": "sobol"}, {"samples": 3500})]


@pytest.mark.parametrize("options", [{}, {"keep": True}, *FURTHER])
def test_three_processes_give_the_bits_of_one_and_each_evaluates_its_share(tmp_path, monkeypatch, options):
    expected, begun, start = run(**options), [], Evaluator.start
    monkeypatch.setattr(Evaluator, "start", lambda self, first: begun.append(first) or start(self, first))
    assert [bits(each) for each in three(tmp_path, **options)] == [bits(expected)] * 3
    assert sorted(begun) == list(range(0, options.get("samples", 9000), 1000))
    assert [file.name for file in tmp_path.iterdir()] == ["c"]
    assert bits(run(checkpoint=tmp_path / "c", **options)) == bits(expected)


def test_what_three_processes_left_is_taken_in_once(tmp_path, monkeypatch):
    def killed(self, counted, study, group):
        group.put(f"counted-{group.number}", b"")
        for number in range(3):
            take(group, f"counted-{number}")
        raise RuntimeError("killed")

    with monkeypatch.context() as patch:
        patch.setattr(Run, "_gathered", killed)
        with pytest.raises(RuntimeError, match="killed"):
            three(tmp_path)
    part, expected = (tmp_path / "c.1-of-3").read_bytes(), bits(run(12_000))
    assert bits(run(12_000, checkpoint=tmp_path / "c")) == expected
    (tmp_path / "c.1-of-3").write_bytes(part)  # it was killed before it removed what it had taken in
    assert bits(run(12_000, checkpoint=tmp_path / "c")) == expected
    assert sorted(file.name for file in tmp_path.iterdir()) == ["c", "shared"]
