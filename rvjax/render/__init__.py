"""Reports of commands: tables whose cells are numbers in SI, and the text, CSV, JSON and HTML that follow from them."""

from rvjax.render.figure import Figure, saved
from rvjax.render.folders import new_folder, numbered_folders, results_folder, write_files
from rvjax.render.quantity import Quantity, number
from rvjax.render.report import Block, Content, Note, Report, Section, as_json, leading_comment, plain, versions
from rvjax.render.table import (
    CSV,
    EVERYWHERE,
    PAGE,
    TEXT,
    Column,
    Interval,
    Limits,
    Number,
    Share,
    Table,
    Text,
    Titled,
    aligned,
    as_csv,
)

__all__ = [
    "CSV",
    "Block",
    "EVERYWHERE",
    "PAGE",
    "TEXT",
    "Column",
    "Content",
    "Figure",
    "Interval",
    "Limits",
    "Note",
    "Number",
    "Quantity",
    "Report",
    "Section",
    "Share",
    "Table",
    "Text",
    "Titled",
    "aligned",
    "as_csv",
    "as_json",
    "leading_comment",
    "new_folder",
    "number",
    "numbered_folders",
    "plain",
    "results_folder",
    "saved",
    "versions",
    "write_files",
]
