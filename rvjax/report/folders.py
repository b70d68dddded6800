"""What an allocation writes into its results folder."""

from collections.abc import Iterator
from pathlib import Path

from rvjax.render import as_csv as as_csv
from rvjax.render import as_json as as_json
from rvjax.render import new_folder as new_folder
from rvjax.render import numbered_folders as numbered_folders
from rvjax.render import results_folder as results_folder
from rvjax.render import write_files as write_files
from rvjax.report import numbers, text
from rvjax.report.pictures import pictures
from rvjax.study.answer import Answer


def write(answer: Answer, folder: Path) -> Path:
    """Write study, tables, JSON and pictures into a new folder, as `write_files` does."""
    return write_files(_files(answer), folder)


def _files(answer: Answer) -> Iterator[tuple[str, bytes]]:
    yield "study.toml", answer.study.text.encode()
    yield "summary.txt", (text.summary(answer) + "\n").encode()
    yield "result.json", as_json(text.as_json(answer))
    for name, (headers, cells) in numbers.tables(answer):
        yield f"{name}.csv", as_csv(headers, cells)
    for picture in pictures(answer):
        yield f"{picture.name}.png", picture.content
