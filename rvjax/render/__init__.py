"""Reports of commands: tables whose cells are numbers in SI, and the text, CSV, JSON and HTML that follow from them."""

from rvjax.render.content import Block as Block, Content as Content, Note as Note, Section as Section
from rvjax.render.figure import FORM as FORM, Figure as Figure, saved as saved
from rvjax.render.folders import (
    new_folder as new_folder,
    numbered_folders as numbered_folders,
    results_folder as results_folder,
    write_files as write_files,
)
from rvjax.render.quantity import Quantity as Quantity, Zone as Zone, micro as micro, number as number
from rvjax.render.report import Report as Report, as_json as as_json, leading_comment as leading_comment, plain as plain
from rvjax.render.table import (
    CSV as CSV,
    EVERYWHERE as EVERYWHERE,
    PAGE as PAGE,
    TEXT as TEXT,
    Cell as Cell,
    Column as Column,
    Interval as Interval,
    Limits as Limits,
    Number as Number,
    Share as Share,
    Table as Table,
    Text as Text,
    Titled as Titled,
    Value as Value,
    aligned as aligned,
    as_csv as as_csv,
    column as column,
)
