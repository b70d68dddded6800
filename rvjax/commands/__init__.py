"""The commands of rvjax: their inputs, and one run. A command is a module here, or a package, and a line in COMMANDS.

Of a command NAME: `NameInputs` has its options as fields, whose metadata are help, unit and choices, and its help as
docstring; `compute(inputs)` works, in the phases that the inputs list; `COUNTED` is the phase that reports which part
of it is done; `report(inputs, found)` describes what was found; `section(table, study)` reads its table of study files.
A run prints text or JSON and writes a results folder. The module of a command is imported when it is first used.

Units have a device of JAX for each core, where units take longer than their start; a GPU, where they take much longer.
"""

import argparse
import contextlib
import dataclasses
import importlib
import json
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, TextIO

from rvjax.base import progress
from rvjax.base.words import terminal_width, wrapped

if TYPE_CHECKING:
    from rvjax.tolerances import Memo


class Inputs:
    """Inputs of a command: a dataclass whose fields are its options; `__post_init__` reads what they name.

    Attributes that a run uses: `phases` that it shows; `quiet`, whether it shows no progress; `folder` of the results,
    None for none; `over`, whether they replace those in it; `memo` of an interrupted run, or None; `command`, the words
    of the command line.
    """

    phases: tuple[str, ...] = ()
    quiet: bool = True
    folder: Path | None = None
    over: bool = False
    memo: "Memo | None" = None
    command: Sequence[str] = ()


def option(
    text: str | None,
    metavar: str | None = None,
    *,
    flag: str = "",
    unit: str = "",
    sign: str = "any",
    ends: str | tuple[str, ...] | None = None,
    **parsing: object,
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


def study_argument(which: str = "", **more: object) -> Any:
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


def flag_of(name: str) -> str:
    """The option of a field: "rated_torque" -> "--rated-torque"."""
    return f"--{name.replace('_', '-')}"


def whole_number(text: str) -> int:
    """A number such as 250000, 1_000_000 or 1e8."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (1 <= number <= 2**53 and number == int(number)):
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number of at least 1")
    return int(number)


# A loop over blocks of units has one thread, so each core becomes a device of JAX, which takes its part of every chunk;
# more devices would leave each too few blocks.
_MOST_DEVICES = 8

_GPU_GAINS = 5.0
"""Seconds of two cores that units take at least for a GPU, which has to start. 131,072 units of all six outputs of
`rv-40e-whole`, 26 s of two cores, took 19 s with start and compilation on an H100."""


def may_use_gpu(command: str, processes: int) -> bool:
    """True if JAX has a GPU, as far as its packages say, and one process of such a command computes many units.

    Args:
        command: its name.
        processes: that share its units.
    """
    return command in ("allocate", "montecarlo", "report") and processes == 1 and find_spec("jax_plugins") is not None


@contextlib.contextmanager
def units_placed(seconds: Callable[[], float | None]) -> Iterator[str]:
    """A context within which units are computed where they gain: on the GPUs of JAX, if `JAX_PLATFORMS` names none.

    All else stays on the default device, for `rvjax` the processor.

    Args:
        seconds: of two cores that the units take, None for unknown; called only if there is a GPU.

    Yields:
        The devices of the units in words.
    """
    import jax

    from rvjax.response import units_devices, units_on

    named, gpus = os.environ.get("JAX_PLATFORMS"), list[jax.Device]()
    with contextlib.suppress(RuntimeError):  # JAX has none
        gpus = jax.local_devices(backend="gpu")
    if gpus and not named and (seconds() or 0.0) < _GPU_GAINS:
        gpus = []
    with units_on(gpus):
        devices = units_devices()
        kind = "the processor" if devices[0].platform == "cpu" else devices[0].device_kind
        yield kind if len(devices) == 1 else f"{kind}, {len(devices)} devices"


def share_cores(processes: int) -> None:
    """A device of JAX for each core, among `processes`; JAX_NUM_CPU_DEVICES says otherwise."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or "host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(RuntimeError):  # the caller of `main` already uses JAX
        jax.config.update("jax_num_cpu_devices", max(1, min(cores // processes, _MOST_DEVICES)))


READING, WRITING = "reading the study", "tables and pictures"  # phases
EXIT_OK, EXIT_NO_ANSWER, EXIT_BAD_INPUT = 0, 1, 2


def say(text: str, file: TextIO | None = None) -> None:
    """Print text; characters that control a terminal are spelled out.

    Args:
        text: one or several lines.
        file: stream; None is standard output.
    """
    from rvjax.base import progress

    lines = (
        "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
        for line in text.split("\n")
    )
    with progress.aside():
        print("\n".join(lines), file=file)


def tell(device: str) -> None:
    """Say where units are computed, if JAX has a GPU: else there is no choice.

    Args:
        device: in words, by `units_placed`.
    """
    import jax

    if any(each.platform != "cpu" for each in jax.local_devices()):
        say(f"rvjax: units on {device}", file=sys.stderr)


COMMANDS = {
    "init": "write a commented study file to change",
    "check": "check the values of a study, estimate the run time",
    "allocate": "the cheapest tolerances that meet the requirements",
    "design": "the cheapest design and tolerances together that meet the requirements",
    "report": "the result of `allocate` as one HTML page",
    "budget": "error budget: variance by error, part, stage and order",
    "compare": "two results of `allocate` side by side",
    "montecarlo": "Monte Carlo statistics, any sample size",
    "identify": "errors of the parts from measured curves, with intervals",
    "reproduce": "published values next to computed ones, with a verdict",
    "tradeoff": "speed and accuracy of every model, measured on this computer",
    "assemble": "match measured parts: parts and positions of every unit",
    "compensate": "correction table for a controller",
    "export": "outlines or sizes of the parts, or the joint model for a simulator",
}
"""Every command with its line in the help, in the order of the help."""

TABLES = {"assembly": "assemble"}
"""Tables of study files that only one command reads, with this command."""


def module(name: str) -> ModuleType:
    """The module of a command."""
    return importlib.import_module(f"rvjax.commands.{name}")


def inputs_of(name: str) -> type[Inputs]:
    """The class of the inputs of a command."""
    return getattr(module(name), f"{name.capitalize()}Inputs")


def section(table: str) -> Callable[[Mapping[str, object], object], object] | None:
    """The function (table, study) -> value that reads a table of study files, None where no command reads it."""
    name = TABLES.get(table)
    return None if name is None else module(name).section


def run(name: str, inputs: Inputs, *, as_json: bool = False) -> int:
    """Run a command; returns the exit code.

    Args:
        name: of the command.
        inputs: its inputs.
        as_json: print one JSON value in SI instead of text.
    """
    from rvjax.base.files import write_atomically  # the help does not wait for NumPy
    from rvjax.render import plain, write_files

    work, folder, width = module(name), inputs.folder, terminal_width()
    with progress.shown(inputs.phases, counted=getattr(work, "COUNTED", ""), quiet=inputs.quiet):
        progress.begin(READING)
        found = work.report(inputs, work.compute(inputs))
        if not as_json and found.content:  # before the folder is made, which may fail
            say(found.text(width) if found.brief is None else wrapped(found.brief, width))
        if folder is not None:
            progress.begin(WRITING)
            folder = write_files(found.folder(), folder, over=inputs.over)
    for path, content in found.exports.items():
        write_atomically(path, content)
    if inputs.memo is not None:
        inputs.memo.clear()
    wrote = {} if folder is None else {"report": folder / found.main} if found.main else {"results": folder}
    if as_json:
        more = dict(found.told) | {name: str(path) for name, path in wrote.items()}
        print(json.dumps(plain(found.data | more if more else found.data), indent=1, allow_nan=False))
    elif closing := [*found.closing, *(f"{'' if found.main else chr(10)}{n.title()}: {p}" for n, p in wrote.items())]:
        say(wrapped("\n".join(closing), width))
    return EXIT_OK if found.ok else EXIT_NO_ANSWER
