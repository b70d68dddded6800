"""Inputs of `rvjax report`: a study, and the folder that may hold its result."""

import argparse
import hashlib
from dataclasses import dataclass
from pathlib import Path

import rvjax
from rvjax import study
from rvjax.base.files import check_writable
from rvjax.commands.allocate import FILE, Answer, expected, restored_from
from rvjax.commands.forecast import forewarn
from rvjax.commands.speak import check_files, share_cores
from rvjax.render import results_folder
from rvjax.study import Study


@dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        study: solved study.
        source: of the study, as named.
        answer: stored result, or None.
        kept: this folder, or None.
        output: file of the page, None for `report.html` in the folder of the result.
        shown: whether this file shows the stored result already.
        sliders: whether the page has sliders: if required, and where a unit takes no millisecond.
        folder: of the results, made for a new result without `output`.
        quiet: show no progress.
    """

    study: Study
    source: str
    answer: Answer | None
    kept: Path | None
    output: Path | None
    shown: bool
    sliders: bool
    folder: Path | None
    quiet: bool


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the key.
    """
    check_files(options, output=".html")
    loaded = study.load(options.study, solve=False)
    if loaded.costly:
        share_cores(1)
    kept, answer = restored_from(loaded)
    output = None if options.output is None else Path(options.output)
    if output is None and kept is not None:
        output = kept / "report.html"
    folder = results_folder(None, loaded.name) if output is None else None
    if output is not None:
        check_writable(output)
    forewarn(loaded, expected(loaded))
    sliders = options.sliders or not loaded.costly
    there = kept is not None and output is not None and shows(output, kept, options.study, sliders)
    shown = there and not options.fresh
    return Inputs(loaded, options.study, answer, kept, output, shown, sliders, folder, options.quiet)


def mark(result: bytes, source: str, sliders: bool) -> bytes:
    """Last line of a page: which stored result it shows, by which version of rvjax, and whether with sliders.

    Args:
        result: content of the stored result.
        source: of the study, as named.
        sliders: whether it has them.
    """
    digest = hashlib.sha256(result + f"{source} {rvjax.__version__}".encode())
    return f"<!-- result {digest.hexdigest()}{' with sliders' if sliders else ''} -->\n".encode()


def shows(page: Path, folder: Path, source: str, sliders: bool) -> bool:
    """True if a page shows the result that a folder stores.

    Args:
        page: file that may exist.
        folder: of a result.
        source: of the study, as named.
        sliders: whether it must have them.
    """
    try:
        result = (folder / FILE).read_bytes()
        return page.read_bytes().endswith(tuple(mark(result, source, own) for own in {True, sliders}))
    except OSError:
        return False
