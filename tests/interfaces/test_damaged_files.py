"""Files that lie, and two who write at once.

Oracles: the run that was never interrupted, to the last bit; what stands in a file, byte by byte. Memory is bounded by
the file itself: a checkpoint of this study is below 2 MB, so 64 MB of growth leaves room for the allocator alone.
"""

import json
import signal
import subprocess
import sys
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from test_cli_montecarlo import SMALL

from rvjax import cli
from rvjax.base.files import digest, pack, unpack
from rvjax.commands.montecarlo import batch
from rvjax.render import Note, Report, new_folder, results_folder, write_files
from rvjax.tolerances import Folder, Requirement, Tolerance, load, monte_carlo, origin

ONE = {"a": Tolerance.symmetric(3.0), "b": Tolerance.symmetric(1.0)}
OPTIONS = dict(samples=5000, seed=1, chunk=1000, requirements=Requirement(upper=2.0))


def units(e):
    return e["a"] + e["b"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A checkpoint after three of five chunks, as bytes."""
    path = tmp_path_factory.mktemp("whole") / "c"
    monte_carlo(units, ONE, checkpoint=path, **(OPTIONS | {"samples": 3000}))
    return path.read_bytes()


def changed(content, **changes):
    """The file with other arrays and the digest that belongs to them; a callable changes what is there."""
    arrays = unpack(content)
    about = json.loads(arrays.pop("about").tobytes())
    for key, change in changes.items():
        if key in about:
            about[key] = change
        elif change is None:
            del arrays[key]
        else:
            arrays[key] = change(arrays[key]) if callable(change) else change
    about["digest"] = digest(arrays) if "digest" not in changes else changes["digest"]
    return pack({**arrays, "about": np.frombuffer(json.dumps(about).encode(), np.uint8)})


def bomb(content):
    """Compressed zeros: 64 MB in 64 kB."""
    from io import BytesIO

    arrays, file = unpack(content), BytesIO()
    np.savez_compressed(file, **{**arrays, "seen": np.zeros(2**23)})
    return file.getvalue()


def boast(content):
    """An array whose header speaks of 8 TB."""
    from io import BytesIO
    from zipfile import ZipFile

    file, header = BytesIO(), BytesIO()
    np.lib.format.write_array_header_1_0(header, dict(descr="<i8", fortran_order=False, shape=(2**40,)))
    with ZipFile(BytesIO(content)) as old, ZipFile(file, "w") as new:
        for name in old.namelist():
            new.writestr(name, header.getvalue() if name == "seen.npy" else old.read(name))
    return file.getvalue()


LIES = {
    "compressed": (bomb, "parts are larger than the file"),
    "boasting": (boast, "shorter than its shape"),
    "cut": (lambda c: c[:-100], "not a zip file"),
    "empty": (lambda c: b"", "not a zip file"),
    "larger than any": (lambda c: c + bytes(3 * 2**26), "bytes, a checkpoint of this study"),
    "one bit": (lambda c: c.replace(b"seen.npy", b"sein.npy"), "not those that were written|other arrays|differ"),
    "digest": (lambda c: changed(c, digest="0"), "not those that were written"),
    "next chunk": (lambda c: changed(c, chunks=np.array([[0, 4]])), "counts of 3000 units, not of 4000"),
    "before the first": (lambda c: changed(c, chunks=np.array([[-1, 2]])), "counted twice, or no"),
    "half a chunk": (lambda c: changed(c, chunks=np.array([[0, 2.5]])), "chunks: float64"),
    "missing": (lambda c: changed(c, joint=None), "other arrays: joint"),
    "one more": (lambda c: changed(c, more=np.zeros(1)), "other arrays: more"),
    "shape": (lambda c: changed(c, seen=np.array([1500, 1500])), "seen: int64 of shape"),
    "numbers for text": (lambda c: changed(c, seen=np.array([3000.0])), "seen: float64"),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_malformed_checkpoint_is_an_error(whole, tmp_path, lie):
    make, words = LIES[lie]
    (tmp_path / "c").write_bytes(make(whole))
    tracemalloc.start()
    try:
        with pytest.raises(ValueError, match=words) as caught:
            monte_carlo(units, ONE, checkpoint=tmp_path / "c", **OPTIONS)
        assert tracemalloc.get_traced_memory()[1] < 2**26
    finally:
        tracemalloc.stop()
    assert "damaged, or no checkpoint" in str(caught.value) and "delete it to start again" in str(caught.value)


def test_an_intact_checkpoint_resumes_to_the_same_bits(whole, tmp_path):
    (tmp_path / "c").write_bytes(changed(whole))
    found = monte_carlo(units, ONE, checkpoint=tmp_path / "c", **OPTIONS)
    assert found.mean == monte_carlo(units, ONE, **OPTIONS).mean


def test_a_result_that_was_compressed_is_refused(whole, tmp_path):
    (tmp_path / "a.npz").write_bytes(bomb(whole))
    with pytest.raises(ValueError, match=r"a\.npz: damaged, or no result of rvjax .*larger than the file"):
        load(tmp_path / "a.npz")


def test_two_processes_that_write_one_file_do_not_mix(tmp_path):
    """Each writes its own letter, longer every time; whoever reads meanwhile finds the whole of one of them."""
    path = tmp_path / "a"
    script = (
        "import sys; from pathlib import Path; from rvjax.base.files import write_atomically\n"
        "for k in range(1, 200): write_atomically(Path(sys.argv[1]), sys.argv[2].encode() * 1000 * k)"
    )
    writers = [subprocess.Popen([sys.executable, "-c", script, str(path), letter]) for letter in "ab"]
    seen = set()
    while any(writer.poll() is None for writer in writers):
        if path.exists():
            content = path.read_bytes()
            assert len(set(content)) == 1 and len(content) % 1000 == 0
            seen.add(content[:1])
        time.sleep(1e-3)
    assert [writer.returncode for writer in writers] == [0, 0] and seen
    assert len(path.read_bytes()) == 199_000 and [file.name for file in tmp_path.iterdir()] == ["a"]


def test_two_processes_check_one_folder_at_once(tmp_path):
    """As two commands of one study begin: neither takes away the trial file of the other, and none is left."""
    script = (
        "import sys; from pathlib import Path; from rvjax.base.files import check_writable\n"
        "for _ in range(3000): check_writable(Path(sys.argv[1]))"
    )
    command = [sys.executable, "-c", script, str(tmp_path / "results" / "study")]
    checks = [subprocess.Popen(command, stderr=subprocess.PIPE) for _ in range(2)]
    said = [check.communicate()[1] for check in checks]
    assert [check.returncode for check in checks] == [0, 0], said
    assert not list(tmp_path.iterdir())


def test_two_runs_of_one_study_write_two_folders(tmp_path, monkeypatch):
    """Both chose the same folder when they began."""
    monkeypatch.chdir(tmp_path)
    wanted = results_folder(None, "s")
    first, second = (write_files(Report("s", (Note(said),)).folder(), wanted) for said in ("one", "two"))
    assert (first, second) == (Path("results/s"), Path("results/s-2"))
    assert [(folder / "summary.txt").read_text() for folder in (first, second)] == ["one\n", "two\n"]
    assert sorted(path.name for path in Path("results").iterdir()) == ["s", "s-2"]
    assert new_folder(wanted) == Path("results/s-3")


def test_a_result_names_the_study_as_it_was_read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small.toml").write_text(SMALL)
    run = batch.run

    def edited(loaded, **how):
        found = run(loaded, **how)
        (tmp_path / "small.toml").write_text("later")
        return found

    monkeypatch.setattr(batch, "run", edited)
    assert cli.main(["montecarlo", "small.toml", "--samples", "100", "--quiet", "--json", "a.json"]) == 0
    assert origin("a.json").study["toml"] == SMALL
    second = Folder(tmp_path, 1, 2)
    second.put("study", SMALL.encode())  # what the first of several processes read, whatever the file says by now
    assert batch.study_of("small.toml", second).text == SMALL


def test_escape_sequences_do_not_reach_the_terminal(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    key = "\x1b]0;owned\x07\x1b[31mred"
    (tmp_path / "s.toml").write_text(SMALL + f'\n["{json.dumps(key)[1:-1]}"]\na = 1\n')
    for command in (["allocate", "s.toml"], ["montecarlo", "s.toml"], ["allocate", f"{key}.toml"]):
        assert cli.main([*command, "--quiet"]) == 2
        said = "".join(capsys.readouterr())
        assert "owned" in said and r"\x1b[31mred" in said
        assert all(c.isprintable() or c == "\n" for c in said)


@pytest.mark.skipif(not hasattr(signal, "SIGTERM") or sys.platform == "win32", reason="no signals")
@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGTERM, 143), pytest.param(signal.SIGINT, 130, marks=pytest.mark.long)]
)
def test_a_signal_ends_a_batch_in_order(tmp_path, number, code):
    """The handler alone: a response that waits to be ended stands for a long run."""
    script = (
        "import sys, time; from rvjax import cli; from rvjax.commands.montecarlo import batch\n"
        "def run(study, **how):\n    print('begun', flush=True)\n    time.sleep(60)\n"
        "batch.run = run\n"
        "study = {'doubts': [], 'accuracy': {}, 'certificate_samples': 1, 'seed': 1}\n"
        "batch.study_of = lambda *_: type('Question', (), study)()\n"
        "sys.modules['rvjax.commands.montecarlo'].unit_seconds = lambda study: None\n"
        "sys.exit(cli.main(['montecarlo', 's.toml', '--checkpoint', 'c']))"
    )
    started = subprocess.Popen(
        [sys.executable, "-c", script], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert started.stdout is not None and started.stdout.readline() == "begun\n"
    time.sleep(0.1)
    started.send_signal(number)
    _, said = started.communicate(timeout=30)
    assert started.returncode == code
    assert "interrupted, the same command resumes from c" in said and "Traceback" not in said
