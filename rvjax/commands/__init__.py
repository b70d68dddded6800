"""The commands of rvjax. A command is a module here, or a package, and a line in COMMANDS of `run.py`.

Of a command NAME: `NameInputs` has its options as fields, and its help as docstring; `compute(inputs)` works, in phases
that `phases(inputs)` lists, if it has any; `COUNTED` is the phase that reports which part of it is done;
`report(inputs, found)` describes what was found; `section(table, study)` reads its table of study files.
"""

from rvjax.commands.console import (
    EXIT_BAD_INPUT as EXIT_BAD_INPUT,
    EXIT_OK as EXIT_OK,
    may_use_gpu as may_use_gpu,
    say as say,
)
from rvjax.commands.inputs import add_options as add_options, read as read, texts_of as texts_of
from rvjax.commands.run import COMMANDS as COMMANDS, TABLES as TABLES, inputs_of as inputs_of, run as run
