"""Parts of the package of a command, imported when first used."""

import importlib
import tomllib
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from rvjax.sections import Reader


def about(name: str) -> dict[str, Any]:
    """Options and help of a command: its `command.toml`."""
    found = find_spec(f"rvjax.commands.{name}")
    assert found is not None and found.submodule_search_locations, f"{name}: no package of rvjax.commands"
    return tomllib.loads((Path(found.submodule_search_locations[0]) / "command.toml").read_text("utf-8"))


def module(name: str, part: str) -> ModuleType:
    """A module of a command: "inputs", "compute" or "report".

    Args:
        name: of the command.
        part: of the module.
    """
    return importlib.import_module(f"rvjax.commands.{name}.{part}")


def section(table: str) -> Reader | None:
    """The function (table, study) -> value that reads a table of study files, None where no command reads it."""
    from rvjax import commands

    found = next((name for name in commands.COMMANDS if about(name).get("table") == table), None)
    return None if found is None else module(found, "inputs").section
