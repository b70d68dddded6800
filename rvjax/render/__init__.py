"""Reports of commands: tables whose cells are numbers in SI, and the text, CSV, JSON and HTML that follow from them."""

from rvjax.render.content import (
    FORM as FORM,
    Block as Block,
    Content as Content,
    Figure as Figure,
    Note as Note,
    Section as Section,
    Table as Table,
    aligned as aligned,
    as_csv as as_csv,
    saved as saved,
)
from rvjax.render.quantity import (
    CSV as CSV,
    EVERYWHERE as EVERYWHERE,
    PAGE as PAGE,
    TEXT as TEXT,
    Cell as Cell,
    Column as Column,
    Interval as Interval,
    Limits as Limits,
    Number as Number,
    Quantity as Quantity,
    Share as Share,
    Text as Text,
    Titled as Titled,
    Value as Value,
    Zone as Zone,
    column as column,
    micro as micro,
    number as number,
)
from rvjax.render.report import (
    Report as Report,
    as_json as as_json,
    leading_comment as leading_comment,
    new_folder as new_folder,
    numbered_folders as numbered_folders,
    plain as plain,
    results_folder as results_folder,
    write_files as write_files,
)
