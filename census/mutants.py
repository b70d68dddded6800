"""Do the tests notice mistakes? Semantic mutants, one at a time, against the tests that must fail.

    python -m census.mutants [--group loaded] [--only "place of the smallest"] [--keep census/mutants.json]

Each mutant of `mutants.toml` is one change that a person could make by mistake: a sign, a factor, a missing term, a
bound. It goes into a copy of the tree. The tests named in its row run, up to the first failure. Before, the same tests
must pass on the unchanged tree. General tools (mutmut, cosmic-ray) change every operator and run every test. That takes
days, because programs compile for seconds; these mutants take an hour. They are not part of continuous integration,
but a fast test compares the table with the code.
"""

import argparse
import ast
import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
TABLE = ROOT / "census" / "mutants.toml"
LIMIT = 600  # s for the tests of one mutant; one that hangs is noticed, too
COPIED = ("rvjax", "tests", "oracles", "census", "benchmarks", "docs", "notebooks", "pyproject.toml")


@dataclass(frozen=True)
class Mutant:
    """One change: in `function`, `expression` becomes `becomes`, and of `tests` (arguments of pytest) one must fail."""

    group: str
    breaks: str
    function: str
    expression: str
    becomes: str
    tests: str
    survives: str = ""  # why no test can notice, for one that is known to live

    def places(self, root: Path = ROOT) -> list[tuple[Path, ast.Module, ast.AST]]:
        """Every place of the expression in the function: file, its syntax tree, and the node."""
        where, name = self.function.split(":")
        path = root / "rvjax" / where.replace(".", "/")
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path.with_suffix(".py")]
        wanted, found = ast.unparse(ast.parse(self.expression)), []
        for file in files:
            text = file.read_text("utf-8")
            if name.split(".")[-1] not in text:
                continue  # parsing every file of a package for every row took ten seconds
            tree = ast.parse(text)
            for function in [tree] if not name else [node for full, node in functions(tree) if full == name]:
                found += [(file, tree, node) for node in matches(function, wanted)]
        return found


def functions(node: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.AST]]:
    """Functions and classes below a node with their full names."""
    for child in ast.iter_child_nodes(node):
        named = isinstance(child, ast.FunctionDef | ast.ClassDef)
        if named:
            yield f"{prefix}{child.name}", child
        yield from functions(child, f"{prefix}{child.name}." if named else prefix)


def matches(node: ast.AST, wanted: str) -> Iterator[ast.AST]:
    """The outermost expressions and statements below a node that read as wanted."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.expr | ast.stmt) and ast.unparse(child) == wanted:
            yield child
        else:
            yield from matches(child, wanted)


class Replacement(ast.NodeTransformer):
    """Puts one node in the place of another."""

    def __init__(self, old: ast.AST, text: str) -> None:
        """The node, and the text of what takes its place."""
        (statement,) = ast.parse(text).body
        self.old, self.new = old, statement.value if isinstance(old, ast.expr) else statement

    def visit(self, node: ast.AST) -> ast.AST:
        """As the base class has it."""
        return self.new if node is self.old else self.generic_visit(node)


def table() -> list[Mutant]:
    """All mutants, in the order of the file."""
    return [Mutant(**row) for row in tomllib.loads(TABLE.read_text("utf-8"))["mutant"]]


def copied(folder: Path) -> None:
    """The tree as the tests need it, without what they made."""
    left = shutil.ignore_patterns("__pycache__", ".pytest_cache", "_build")
    for name in (*COPIED, *(path.name for path in ROOT.glob("*.md"))):
        source = ROOT / name
        (shutil.copytree if source.is_dir() else shutil.copy)(
            source, folder / name, **({"ignore": left} if source.is_dir() else {})
        )


def run(folder: Path, tests: str) -> str:
    """ "passed", "failed", "hangs", or what kept pytest from running them."""
    command = [sys.executable, "-m", "pytest", "-n", "0", "-p", "no:cacheprovider", "-x", *shlex.split(tests)]
    kept = os.environ.get("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".pytest_cache" / "jax"))
    here = {**os.environ, "PYTHONPATH": str(folder), "JAX_COMPILATION_CACHE_DIR": kept}
    try:
        found = subprocess.run(command, cwd=folder, env=here, capture_output=True, text=True, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return "hangs"
    if found.returncode in (0, 1):
        return ("passed", "failed")[found.returncode]
    return f"pytest ended with {found.returncode}: {(found.stdout + found.stderr).strip()[-300:]}"


def verdict(folder: Path, mutant: Mutant) -> str:
    """ "killed", "survived", or what is wrong with the row of the table."""
    places = mutant.places(folder)
    if len(places) != 1:
        return f"{mutant.function} has the expression {len(places)} times"
    path, tree, node = places[0]
    whole = path.read_text("utf-8")
    changed = Replacement(node, mutant.becomes).visit(tree)
    path.write_text(ast.unparse(ast.fix_missing_locations(changed)), "utf-8")
    try:
        found = run(folder, mutant.tests)
    finally:
        path.write_text(whole, "utf-8")
    return {"failed": "killed", "hangs": "killed", "passed": "survived"}.get(found, found)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m census.mutants", description=__doc__.split("\n")[0])
    parser.add_argument("--group", help="this group alone")
    parser.add_argument("--only", help="mutants whose `breaks` holds this text")
    parser.add_argument("--keep", help="JSON file for the score")
    parser.add_argument("--trust", action="store_true", help="the tests are known to pass on the tree as it is")
    options = parser.parse_args(arguments)
    mutants = [m for m in table() if options.group in (None, m.group) and (options.only or "") in m.breaks]
    started, score = time.perf_counter(), dict[str, list[int]]()
    survivors, wrong = [], []
    with tempfile.TemporaryDirectory(prefix="rvjax-mutants-") as name:
        folder = Path(name)
        copied(folder)
        sound: dict[str, str] = {}
        for mutant in mutants:
            if not options.trust and mutant.tests not in sound:
                sound[mutant.tests] = run(folder, mutant.tests)
            begun = time.perf_counter()
            before = sound.get(mutant.tests, "passed")
            found = verdict(folder, mutant) if before == "passed" else f"without the mutant: {before}"
            print(f"{mutant.group:12} {found:9.200} {time.perf_counter() - begun:4.0f} s  {mutant.breaks}", flush=True)
            if found not in ("killed", "survived"):
                wrong.append(mutant)
                continue
            count = score.setdefault(mutant.group, [0, 0])
            count[0] += found == "killed"
            count[1] += 1
            survivors += [mutant] if found == "survived" else []
    minutes = (time.perf_counter() - started) / 60
    for group, (killed, count) in score.items():
        print(f"{group:12} {killed:3} of {count:3}")
    killed, count = (sum(column) for column in zip(*score.values())) if score else (0, 0)
    print(f"all          {killed:3} of {count:3}, {minutes:.0f} min")
    for mutant in survivors:
        print(f"survived: {mutant.group}: {mutant.breaks}: {mutant.survives or 'no reason known'}")
    if options.keep:
        kept = {"groups": score, "survivors": [m.breaks for m in survivors], "minutes": round(minutes)}
        Path(options.keep).write_text(json.dumps(kept, indent=1) + "\n", "utf-8")
    return int(bool(wrong) or any(not m.survives for m in survivors))


if __name__ == "__main__":
    sys.exit(main())
