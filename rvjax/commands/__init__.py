"""The commands of rvjax. A command is a package here, and a line in COMMANDS.

Its `command.toml` holds its options and help; `inputs.py` reads options, study and files, `compute.py` computes,
`report.py` says what was found. `table` in `command.toml` names a table of study files that the command reads.
"""

from rvjax.base.sections import Reader
from rvjax.commands.run import about as about, module as module, run as run
from rvjax.commands.speak import (
    EXIT_BAD_INPUT as EXIT_BAD_INPUT,
    EXIT_NO_ANSWER as EXIT_NO_ANSWER,
    EXIT_OK as EXIT_OK,
    READING as READING,
    WRITING as WRITING,
    check_files as check_files,
    may_use_gpu as may_use_gpu,
    say as say,
    share_cores as share_cores,
    units_placed as units_placed,
)

COMMANDS = [
    "init",
    "check",
    "allocate",
    "design",
    "report",
    "budget",
    "compare",
    "montecarlo",
    "identify",
    "reproduce",
    "tradeoff",
    "assemble",
    "compensate",
    "export",
]
"""Every command, in the order of the help."""


def section(table: str) -> Reader | None:
    """The function (table, study) -> value that reads a table of study files, None where no command reads it."""
    found = next((name for name in COMMANDS if about(name).get("table") == table), None)
    return None if found is None else module(found, "inputs").section
