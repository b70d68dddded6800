"""The table of mutants fits the tree, and the page shows the last score of `python -m benchmarks.census.mutants`."""

import ast
import functools
import itertools
import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from _pytest.mark.expression import Expression

from benchmarks.census import mutants

ROOT = Path(__file__).parents[1]


@pytest.mark.long  # a job of the workflow: 800 rows against the whole package
def test_every_expression_is_there_once_and_its_tests_exist():
    """A change of the code that removes a mutant's expression has to bring another one."""
    found = mutants.table()
    assert [(m.breaks, m.function, n) for m in found if (n := len(m.places())) != 1] == []
    assert len({m.breaks for m in found}) == len(found) >= 60
    for mutant in found:
        assert mutant.expression != mutant.becomes, mutant.breaks
        assert selected(mutant.tests), mutant.breaks


def selected(tests: str) -> list[str]:
    """Tests of a file that a row names: all, or those that the words after -k may select.

    pytest matches a word with the names of test and file and with the ids of parameters, in capitals or not. These ids
    are somewhere in the text of the decorators and fixtures of a test, or of what these name in the folder of tests.
    """
    path, *rest = shlex.split(tests)
    assert not rest or (rest[0] == "-k" and len(rest) == 2), tests
    defined = _defined(path)
    functions = [item for name, item in defined.items() if name.startswith("test_")]
    return [item.name for item in functions if not rest or _may_match(item, path, defined, rest[1])]


@functools.cache
def _defined(path: str) -> dict[str, ast.AST]:
    defined = {}
    for item in ast.parse((ROOT / path).read_text("utf-8")).body:
        names = [t.id for t in getattr(item, "targets", ()) if isinstance(t, ast.Name)]
        if isinstance(item, ast.ImportFrom) and (ROOT / "tests" / f"{item.module}.py").is_file():
            whole = ast.parse((ROOT / "tests" / f"{item.module}.py").read_text("utf-8"))
            defined |= {alias.name: whole for alias in item.names}
        defined |= dict.fromkeys([item.name] if hasattr(item, "name") else names, item)
    return defined


@functools.cache
def _text(part: ast.AST) -> str:
    return ast.unparse(part).lower()


_compiled = functools.cache(Expression.compile)


@functools.cache
def _names(part: ast.AST) -> frozenset[str]:
    return frozenset(node.id for node in ast.walk(part) if isinstance(node, ast.Name))


def _may_match(test: ast.FunctionDef, path: str, defined: dict[str, ast.AST], words: str) -> bool:
    sure, compiled = f"{test.name} {path}".lower(), _compiled(words)
    if compiled.evaluate(lambda word, **_: word.lower() in sure):
        return True
    waiting = [*test.decorator_list, *(defined[a.arg] for a in test.args.args if a.arg in defined)]
    ids, seen = "", set()
    while waiting:
        ids += _text(part := waiting.pop())
        names = _names(part) & set(defined) - seen
        waiting, seen = waiting + [defined[name] for name in names], seen | names
    asked = set(re.findall(r"[\w.-]+", words.lower())) - {"and", "or", "not"}
    some = [word for word in asked if word not in sure and word in ids]  # of one case, maybe not of another
    choices = itertools.product((True, False), repeat=len(some))
    found = ({word: word in sure for word in asked} | dict(zip(some, c)) for c in choices)
    return any(compiled.evaluate(lambda word, of=of, **_: of[word.lower()]) for of in found)


def test_words_that_select_no_test_are_found():
    """Of this file: part of a name, capitals, not, two words, and words of no test."""
    here, name = "tests/test_mutants.py", test_every_package_has_its_mutants.__name__
    assert len(selected(here)) >= 6 and selected(f"{here} -k every_package") == [name]
    assert selected(f"{here} -k 'EVERY_package and not expression'") == [name]
    assert len(selected(f"{here} -k 'every_package or last_score'")) == 2
    assert selected(f"{here} -k every_packages") == selected(f"{here} -k 'every_package and score'") == []


def test_a_row_that_selects_no_test_fails(tmp_path, monkeypatch, capsys):
    """Of three rows of one file that passes: the second selects nothing, the third a test that is skipped."""
    (tmp_path / "test_x.py").write_text(
        "import pytest\n\ndef test_one():\n    pass\n\n@pytest.mark.skip\ndef test_two():\n    pass\n"
    )
    rows = [mutants.Mutant("a", word, "m:f", "1", "2", f"test_x.py -k {word}") for word in ("one", "three", "two")]
    monkeypatch.setattr(mutants, "table", lambda: rows)
    monkeypatch.setattr(mutants, "copied", lambda folder: shutil.copy(tmp_path / "test_x.py", folder))
    monkeypatch.setattr(mutants, "verdict", lambda folder, row: mutants.run(folder, row.tests))
    monkeypatch.setattr(mutants, "FIRST", ["pytest"])
    assert mutants.main([]) == 1
    outcomes = [line.split()[:2] for line in capsys.readouterr().out.splitlines() if " s  " in line]
    assert outcomes == [["a", "passed"], ["a", "no"], ["a", "no"]]


def test_a_mutant_changes_its_expression_and_nothing_else(tmp_path):
    home = tmp_path / "rvjax" / "pack"
    home.mkdir(parents=True)
    source = "def f(a):\n    # a comment\n    return a - (1 + 2) * a\n\n\ndef g(a):\n    return 1 + 2\n"
    (home / "module.py").write_text(source)
    row = mutants.Mutant("pack", "a sum", "pack:f", "(1 + 2)*a", "(1 - 2) * a", "")
    ((path, tree, node),) = row.places(tmp_path)
    assert path == home / "module.py"
    changed = ast.unparse(mutants.Replacement(node, row.becomes).visit(tree))
    names: dict = {}
    exec(changed, names)
    assert names["f"](5) == 10 and names["g"](5) == 3  # before: -10 and 3


def test_every_package_has_its_mutants():
    """Plots and commands are shown, not computed."""
    touched = {m.function.split(":")[0].split(".")[0] for m in mutants.table()}
    packages = {path.parent.name for path in (ROOT / "rvjax").glob("*/__init__.py")}
    assert packages - touched <= {"cli", "commands", "plotting", "render"}


def test_the_page_shows_the_last_score():
    """Of the mutants that the run reached; a survivor has its reason in the table."""
    kept = json.loads((ROOT / "benchmarks" / "census" / "mutants.json").read_text("utf-8"))
    page = (ROOT / "docs" / "stability.md").read_text("utf-8")
    of_group = [m.group for m in mutants.table()]
    assert set(kept["groups"]) <= set(of_group)
    for group, (killed, count) in kept["groups"].items():
        assert f"| {group} | {killed} of {count} |" in page and count <= of_group.count(group)
    killed, count = (sum(column) for column in zip(*kept["groups"].values()))
    assert f"| all | {killed} of {count} |" in page and killed >= 0.95 * count
    assert set(kept["survivors"]) <= {m.breaks for m in mutants.table() if m.survives}
    assert all(breaks in page for breaks in kept["survivors"])


def test_rows_of_one_file_are_checked_together_and_a_journal_goes_on(tmp_path, monkeypatch, capsys):
    """Three rows: the first is noticed, the second not, the tests of the third fail without it."""
    rows = [mutants.Mutant("a", f"row {k}", "m:f", "1", "2", f"tests/test_{'bad' if k == 2 else 'x'}.py -k 'x{k}'")
            for k in range(3)]  # fmt: skip
    ran = []
    monkeypatch.setattr(mutants, "table", lambda: rows)
    monkeypatch.setattr(mutants, "copied", lambda folder: None)
    tried = lambda folder, tests: ran.append(tests) or ("failed" if "bad" in tests else "passed")  # noqa: E731
    monkeypatch.setattr(mutants, "run", tried)
    monkeypatch.setattr(mutants, "verdict", lambda folder, row: "killed" if row is rows[0] else "survived")
    options = ["--journal", str(tmp_path / "rows"), "--keep", str(tmp_path / "kept.json")]
    assert mutants.main(options) == 1
    assert sorted(ran) == ["tests/test_bad.py -k '(x2)'", "tests/test_x.py -k '(x0) or (x1)'"]
    kept = json.loads((tmp_path / "kept.json").read_text())
    assert (kept["groups"], kept["survivors"]) == ({"a": [1, 2]}, ["row 1"])
    assert "without the mutant: failed" in capsys.readouterr().out
    ran.clear()
    assert mutants.main(options) == 1 and ran == ["tests/test_bad.py -k '(x2)'"]
