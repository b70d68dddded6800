"""The commands of rvjax. A command is a package here, and a line in COMMANDS.

Its `command.toml` holds its options and help; `inputs.py` reads options, study and files, `compute.py` computes,
`report.py` says what was found. `table` in `command.toml` names a table of study files that the command reads.
"""

from rvjax.commands.cores import share_cores
from rvjax.commands.registry import about, module, section
from rvjax.commands.run import run
from rvjax.commands.speak import (
    EXIT_BAD_INPUT,
    EXIT_NO_ANSWER,
    EXIT_OK,
    READING,
    WRITING,
    check_files,
    forewarn,
    say,
    tell,
)

COMMANDS = [
    "init",
    "check",
    "allocate",
    "report",
    "budget",
    "compare",
    "montecarlo",
    "identify",
    "reproduce",
    "tradeoff",
    "assemble",
    "compensate",
]
"""Every command, in the order of the help."""

__all__ = [
    "COMMANDS",
    "EXIT_BAD_INPUT",
    "EXIT_NO_ANSWER",
    "EXIT_OK",
    "READING",
    "WRITING",
    "about",
    "check_files",
    "forewarn",
    "module",
    "run",
    "say",
    "section",
    "share_cores",
    "tell",
]
