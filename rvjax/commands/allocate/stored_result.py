"""Stored result of a study: same study, same version of rvjax."""

import json
import os
import tempfile
from pathlib import Path

import rvjax
from rvjax import tolerances
from rvjax.base.files import versions
from rvjax.commands.allocate.answer import Answer, Side
from rvjax.commands.allocate.full_model_check import Unlimited, Whole
from rvjax.records import PyTree
from rvjax.render import numbered_folders
from rvjax.study import Study
from rvjax.tolerances import Memo


def folder(study: Study, option: str | None) -> Path | None:
    """Find the latest results folder that holds the result of a study, or None.

    A study that names other files is always recomputed, because the files may have changed.

    Args:
        study: the question.
        option: folder of the command line; None for all under `results` with the name of the study.
    """
    if _names_files(study.tables):
        return None
    known = [Path(option)] if option is not None else numbered_folders(study.name)
    return next((place for place in reversed(known) if _holds(place, study)), None)


def memo(study: Study, place: Path) -> Memo | None:
    """Folder for intermediate results of an allocation; None if the study names other files."""
    if _names_files(study.tables):
        return None
    about = {"study": study.text, "flags": os.environ.get("XLA_FLAGS", "")}
    return Memo(place.with_name(place.name + ".part"), about | versions())


FILE = "answer.npz"
"""Stored part of a result: with the study, it determines all tables and plots."""


def stored(answer: Answer) -> bytes:
    """Write a result as the content of a file."""
    sides = {name: dict(vars(getattr(answer, name))) for name in ("before", "after")}
    found = {name: getattr(answer, name) for name in ("allocation", "certificate_before", "cost_curve")} | sides
    if answer.whole is not None:
        found["whole"] = dict(vars(answer.whole))
    found["unlimited"] = {name: dict(vars(one)) for name, one in answer.unlimited.items()}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, FILE)
        tolerances.save(found, path, study={"name": answer.study.name}, seed=answer.study.seed)
        return path.read_bytes()


def restored_from(study: Study) -> tuple[Path, Answer] | tuple[None, None]:
    """Find the latest results folder with the result of a study, and read the result; None without a folder."""
    place = folder(study, None)
    found = None if place is None else restored(study, place)
    return (None, None) if place is None or found is None else (place, found)


def restored(study: Study, place: Path) -> Answer | None:
    """Read the result of a study from its folder; None without the file, or with one of another rvjax."""
    try:
        found: dict[str, PyTree] = tolerances.load(place / FILE)
        found |= {name: Side(**found[name]) for name in ("before", "after")}
        found |= {"whole": Whole(**found["whole"])} if "whole" in found else {}
        found["unlimited"] = {name: Unlimited(**one) for name, one in found["unlimited"].items()}
        return Answer(study=study, **found)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def status(place: Path) -> str:
    """Read the final status of the allocation in a results folder."""
    return str(json.loads((place / "result.json").read_text("utf-8"))["status"])


def _holds(place: Path, study: Study) -> bool:
    try:
        if (place / "study.toml").read_text("utf-8") != study.text or not (place / "summary.txt").is_file():
            return False
        found = json.loads((place / "result.json").read_text("utf-8"))
        return bool(
            found["versions"]["rvjax"] == rvjax.__version__ and found["study"] == study.name and found["status"]
        )
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # another folder, or a damaged one
        return False


def _names_files(tables: object) -> bool:
    if isinstance(tables, dict):
        return "file" in tables or any(map(_names_files, tables.values()))
    return isinstance(tables, list) and any(map(_names_files, tables))
