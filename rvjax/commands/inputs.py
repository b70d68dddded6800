"""Options of a command as fields of its inputs: help, unit and choices are metadata, and the parser follows from them.

The docstring of the inputs is the help of the command: its description, and from "examples:" on what follows the list
of options.
"""

import argparse
import dataclasses
import inspect
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from rvjax.tolerances import Memo


class Inputs:
    """Inputs of a command: a dataclass whose fields are its options; `__post_init__` reads what they name.

    Attributes that a run uses: `quiet`, whether it shows no progress; `folder` of the results, None for none; `over`,
    whether they replace those in it; `memo` of an interrupted run, or None; `command`, the words of the command line.
    """

    quiet: bool = True
    folder: Path | None = None
    over: bool = False
    memo: "Memo | None" = None
    command: Sequence[str] = ()


I = TypeVar("I", bound=Inputs)  # noqa: E741


def option(
    text: str | None,
    metavar: str | None = None,
    *,
    flag: str = "",
    unit: str = "",
    sign: str = "any",
    ends: str | tuple[str, ...] | None = None,
    **parsing: Any,
) -> Any:
    """An option: a field of inputs.

    Args:
        text: its help, None for an option that is not shown.
        metavar: placeholder of its value in the help.
        flag: such as "--as"; "" for the name of the field.
        unit: SI unit; what the user writes has a unit, such as "412 N m".
        sign: of a value with a unit: "any", "positive" or "nonnegative".
        ends: ending, or tuple of endings, of a file that is written; its folder must exist.
        **parsing: `default` (None), `type`, `choices` ... as `argparse` reads them.
    """
    about = {"help": argparse.SUPPRESS if text is None else text, "metavar": metavar, **parsing}
    about = {key: value for key, value in about.items() if value is not None}
    metadata = {"parser": about, "flag": flag, "unit": unit, "sign": sign, "ends": ends}
    return dataclasses.field(default=parsing.get("default"), metadata=metadata)


def argument(text: str, metavar: str, **more: Any) -> Any:
    """An argument without a flag, required unless it has a `default`.

    Args:
        text: its help.
        metavar: placeholder of its value in the help.
        **more: as in `option`.
    """
    several = {"nargs": "?"} if "default" in more and "nargs" not in more else {}
    return option(text, metavar, flag=".", **several, **more)


def study_argument(which: str = "", **more: Any) -> Any:
    """The argument that names a study; a command reads it in `__post_init__`.

    Args:
        which: embedded studies of the command, for the help.
        **more: `default`, a study.
    """
    return argument(f"a study file (.toml), or an embedded study{which}", "STUDY", **more)


def switch(text: str, **more: Any) -> Any:
    """An option without a value: False unless it is given.

    Args:
        text: its help.
        **more: as in `option`.
    """
    return option(text, action="store_true", default=False, **more)


def quiet_option() -> Any:
    """The option that hides progress."""
    return switch("do not print progress")


def results_option(name: str) -> Any:
    """The option that names the results folder.

    Args:
        name: of the folder without the option, below `results`.
    """
    return option(f"new folder for the results (default: results/{name}, numbered if it exists)", "DIR")


def encoding_option() -> Any:
    """The option with the encoding of a CSV file."""
    return option("encoding of the data, such as cp932 (default: UTF-8, UTF-16 or a guess)", "NAME")


def whole_number(text: str) -> int:
    """A number such as 250000, 1_000_000 or 1e8."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (1 <= number <= 2**53 and number == int(number)):
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number of at least 1")
    return int(number)


def texts_of(inputs: type[Inputs]) -> dict[str, str]:
    """Description and epilog of a command."""
    text, examples, rest = inspect.cleandoc(inputs.__doc__ or "").partition("\n\nexamples:")
    return {"description": text, "epilog": f"{examples.strip()}{rest}\n"} if examples else {"description": text}


def add_options(parser: argparse.ArgumentParser, inputs: type[Inputs]) -> None:
    """Add the options of a command to its parser.

    Args:
        parser: of the command.
        inputs: its class.
    """
    for field in dataclasses.fields(inputs):  # type: ignore[arg-type]
        about, name = field.metadata, field.name
        if about["flag"] == ".":
            parser.add_argument(name, **about["parser"])
        else:
            parser.add_argument(about["flag"] or flag_of(name), dest=name, **about["parser"])


def read(inputs: type[I], options: argparse.Namespace) -> I:
    """The inputs that parsed options give.

    Args:
        inputs: their class.
        options: as parsed.

    Raises:
        ValueError: one line that names the option or the key.
    """
    given = {}
    for field in dataclasses.fields(inputs):  # type: ignore[arg-type]
        about, value = field.metadata, getattr(options, field.name)
        named = about["flag"] or flag_of(field.name)
        if value is not None and about["ends"] is not None:
            _check_file(str(value) if named == "." else f"{named} {value}", str(value), about["ends"])
        if value is not None and about["unit"]:
            value = _size(value, named, about)
        given[field.name] = value
    return inputs(**given)


def flag_of(name: str) -> str:
    """The option of a field: "rated_torque" -> "--rated-torque"."""
    return f"--{name.replace('_', '-')}"


def _size(text: str, named: str, about: Mapping[str, Any]) -> float:
    """Value of a text with a unit, SI."""
    from rvjax.study import quantity  # the list of commands does not wait for JAX

    value = quantity(text, about["unit"], named)
    if (value <= 0 and about["sign"] == "positive") or (value < 0 and about["sign"] == "nonnegative"):
        rule = "be positive" if about["sign"] == "positive" else "not be negative"
        raise ValueError(f"{named} = {text!r}: must {rule}")
    return value


def _check_file(named: str, path: str, ends: str | tuple[str, ...]) -> None:
    """Raise an error for a file that could not be written, before any work is done."""
    if not path.endswith(ends):
        raise ValueError(f"{named}: must end with {ends if isinstance(ends, str) else ' or '.join(ends)}")
    if not Path(path).absolute().parent.is_dir():
        raise ValueError(f"{named}: there is no such folder")
