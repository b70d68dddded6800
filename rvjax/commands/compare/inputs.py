"""Inputs of `rvjax compare`: results folders of `rvjax allocate`, and the study that certifies them."""

import argparse
import dataclasses
from pathlib import Path

from rvjax import study
from rvjax.commands.compare.results import Result, result
from rvjax.commands.forecast import forewarn
from rvjax.records import PyTree
from rvjax.study import Study


@dataclasses.dataclass(frozen=True)
class Inputs:
    """Inputs of the command.

    Attributes:
        paths: of the results, by letter.
        results: what they hold, by letter.
        study: that certifies their tolerances, or None.
        answers: study and tolerances of each result, by letter; empty without `study`.
        samples: units of a certificate, None: as many as the study certifies with.
    """

    paths: dict[str, str]
    results: dict[str, Result]
    study: Study | None = None
    answers: dict[str, tuple[Study, PyTree]] = dataclasses.field(default_factory=dict)
    samples: int | None = None


def inputs(options: argparse.Namespace) -> Inputs:
    """The inputs that the options name.

    Raises:
        ValueError: one line that names the option or the folder.
    """
    if options.second is None and options.on is None:
        raise ValueError("B is missing: name two results folders, or one folder and --on STUDY")
    if options.samples is not None and options.on is None:
        raise ValueError(f"--samples {options.samples}: only with --on STUDY")
    paths = {letter: path for letter, path in zip("AB", (options.first, options.second)) if path is not None}
    results = {letter: result(path) for letter, path in paths.items()}
    if options.on is None:
        return Inputs(paths, results)
    loaded = study.load(options.on, solve=False)  # a unit that fails counts among the others
    answers = {letter: answered(path) for letter, path in paths.items()}
    forewarn(loaded)
    return Inputs(paths, results, loaded, answers, options.samples)


def answered(path: str) -> tuple[Study, PyTree]:
    """The study of a results folder, and the tolerances that it found, with their distributions.

    Args:
        path: of the folder, or of the result.json in it.

    Raises:
        ValueError: no results folder of `rvjax allocate`, or its study and its result do not fit each other.
    """
    found = result(path)
    folder = Path(path) if Path(path).is_dir() else Path(path).parent
    try:
        written = (folder / "study.toml").read_text("utf-8")
    except (OSError, UnicodeDecodeError):
        raise ValueError(f"{folder}: there is no study.toml next to the result, which has the distributions") from None
    loaded = study.parse_study(written, name=str(found["study"]), folder=folder, solve=False)
    try:
        limits = {name: (one["after"]["lower"], one["after"]["upper"]) for name, one in found["tolerances"].items()}
        tolerances = {
            name: getattr(loaded.tolerances, name).replace(lower=lower, upper=upper)
            for name, (lower, upper) in limits.items()
        }
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path}: no result of the study next to it ({error!r})") from None
    return loaded, loaded.tolerances.replace(**tolerances)
