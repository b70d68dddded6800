"""Size of the code: lines, files, long classes and functions, and places that distinguish costly responses.

    python -m benchmarks.size                        table of this tree
    python -m benchmarks.size --way rv-40e-whole     also the files that `rvjax allocate` of a study runs through

A code line has a token that is no comment and no docstring. A place that distinguishes costly responses is a code line
with the name `costly` or `is_costly` in it, or with `effort.tails`, which says the same of a search. A number at module
level is an assignment of numbers, or of tuples of them.
"""

import argparse
import ast
import io
import sys
import tempfile
import tokenize
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[1]
OPTIMISER = ROOT / "rvjax" / "tolerances" / "allocation"
LONG_CLASS, LONG_FUNCTION = 200, 60
COSTLY = {"costly", "_costly", "is_costly"}
TAILS = ["effort", ".", "tails"]
_LAYOUT = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}


class Source(NamedTuple):
    """One file: its syntax tree, code lines, and those that distinguish costly responses."""

    path: Path
    tree: ast.Module
    lines: set[int]
    costly: set[int]

    def length(self, node: ast.AST) -> int:
        """Code lines of a class or function."""
        first = min([node.lineno, *(d.lineno for d in getattr(node, "decorator_list", []))])  # type: ignore[attr-defined]
        return len(self.lines & set(range(first, node.end_lineno + 1)))  # type: ignore[attr-defined]


def source(path: Path) -> Source:
    """A file as a tree and its code lines."""
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    docs = {
        line
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines, costly = set[int](), set[int]()
    before = ["", ""]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _LAYOUT:
            lines |= set(range(token.start[0], token.end[0] + 1))
        if token.type == tokenize.NAME and (token.string in COSTLY or [*before, token.string] == TAILS):
            costly.add(token.start[0])
        before = [before[1], token.string]
    return Source(path, tree, lines - docs, costly - docs)


def sources(folder: Path) -> list[Source]:
    """All Python files of a folder."""
    return [source(path) for path in sorted(folder.rglob("*.py"))]


def long_ones(files: list[Source], kinds: tuple[type, ...], most: int) -> Iterator[tuple[str, int]]:
    """Names and code lines of the classes or functions above so many.

    Args:
        files: where they are.
        kinds: of nodes.
        most: code lines.
    """
    for file in files:
        for node in ast.walk(file.tree):
            if isinstance(node, kinds) and (count := file.length(node)) > most:
                yield f"{file.path.relative_to(ROOT)}: {node.name}", count  # type: ignore[attr-defined]


def numbers(files: list[Source]) -> int:
    """Numbers at module level."""
    return sum(
        isinstance(leaf, ast.Constant) and isinstance(leaf.value, int | float) and not isinstance(leaf.value, bool)
        for file in files
        for node in file.tree.body
        if isinstance(node, ast.Assign | ast.AnnAssign) and isinstance(node.value, _PLAIN)
        for leaf in ast.walk(node.value)
    )


_PLAIN = (ast.Constant, ast.Tuple, ast.UnaryOp, ast.BinOp, ast.Dict)


def way(study: str) -> list[str]:
    """Files of the package with a function that `rvjax allocate` of a study calls, few units.

    Args:
        study: its name.
    """
    from rvjax import cli

    seen = Counter[str]()

    def called(frame: Any, event: str, _: object) -> None:
        if event == "call":
            seen[frame.f_code.co_filename] += 1

    with tempfile.TemporaryDirectory() as folder:
        line = ["allocate", study, "--set", "run.samples=128", "--set", "run.certificate_samples=512", "--out", folder]
        sys.setprofile(called)
        try:
            cli.main(line)
        finally:
            sys.setprofile(None)
    inside = f"{ROOT / 'rvjax'}/"
    return sorted(path[len(inside) :] for path in seen if path.startswith(inside))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--way", metavar="STUDY", help="also count the files on the way of an allocation")
    options = parser.parse_args()
    folders = {name: sources(ROOT / name) for name in ("rvjax", "tests", "benchmarks")}
    print(f"{'folder':36} {'files':>6} {'code lines':>10}")
    for name, files in folders.items():
        print(f"{name:36} {len(files):6,} {sum(len(file.lines) for file in files):10,}")
    own = folders["rvjax"]
    for package in sorted(path for path in (ROOT / "rvjax").iterdir() if (path / "__init__.py").exists()):
        files = [file for file in own if package in file.path.parents]
        print(f"  {package.relative_to(ROOT)!s:34} {len(files):6,} {sum(len(file.lines) for file in files):10,}")
    print(f"\ncode lines of `rvjax` that distinguish costly responses: {sum(len(file.costly) for file in own)}")
    print(f"numbers at module level of `rvjax/tolerances/allocation`: {numbers(sources(OPTIMISER))}")
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    for what, kinds, most in (("classes", (ast.ClassDef,), LONG_CLASS), ("functions", functions, LONG_FUNCTION)):
        found = sorted(long_ones(own, kinds, most), key=lambda item: -item[1])
        print(f"\n{what} above {most} code lines: {len(found)}")
        for name, count in found:
            print(f"  {count:4} {name}")
    if options.way:
        files = way(options.way)
        print(f"\nfiles on the way of `rvjax allocate {options.way}`: {len(files)}")


if __name__ == "__main__":
    main()
