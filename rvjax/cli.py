"""The command line: one parser for all commands, whose inputs have their options and help.

Bad input ends with one line on standard error and exit code 2; a study without a result
(infeasible requirements) with exit code 1.
"""

import argparse
import contextlib
import dataclasses
import gc
import inspect
import io
import logging
import os
import signal
import sys
import tomllib
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from rvjax import commands
from rvjax.base.words import refilled, terminal_width

I = TypeVar("I", bound=commands.Inputs)  # noqa: E741


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    given = sys.argv[1:] if arguments is None else list(arguments)
    name = next((word for word in given if word in commands.COMMANDS), None)
    if name is None:  # help, version or an unknown command
        return _parsed(_parser(), given)[1]
    shared = any(word.partition("=")[0] in ("--processes", "--worker") for word in given)
    _prepare(gpu=commands.may_use_gpu(name, 2 if shared else 1))
    from rvjax.base.frames import MissingExtra
    from rvjax.base.progress import ended_by

    options, inputs = None, None
    try:
        with ended_by(signal.SIGTERM, _Terminated()):
            options, code = _parsed(_parser(name), given)
            if options is None:
                return code
            inputs = read(commands.inputs_of(name), options)
            inputs.command = given
            as_json = options.format == "json" or getattr(options, "json", None) is True  # `--json` that names no file
            code = commands.run(name, inputs, as_json=as_json)
            sys.stdout.flush()  # here, and not at the end of the interpreter, which would complain
        return code
    except BrokenPipeError:  # the reader has closed the pipe, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer goes nowhere
        return commands.EXIT_OK
    except (ValueError, OSError, MissingExtra) as error:
        commands.say(f"rvjax: error: {' '.join(str(error).split())}", file=sys.stderr)
        return commands.EXIT_BAD_INPUT
    except KeyboardInterrupt as stop:
        memo = inputs and inputs.memo
        file = getattr(options, "checkpoint", None) or (memo.folder if memo and memo.folder.exists() else None)
        rest = f"the same command resumes from {file}" if file else "nothing was written"
        commands.say(f"rvjax: interrupted, {rest}", file=sys.stderr)
        return 143 if isinstance(stop, _Terminated) else 130


class _Terminated(KeyboardInterrupt):
    """SIGTERM ends a command as Ctrl-C does; unfinished files are removed."""


def _parsed(parser: argparse.ArgumentParser, given: Sequence[str]) -> tuple[argparse.Namespace | None, int]:
    """The options, or None and the exit code where argparse wrote the error or the help."""
    try:
        return parser.parse_args(given), commands.EXIT_OK
    except SystemExit as stop:
        return None, int(stop.code or 0)


def _parser(chosen: str = "") -> argparse.ArgumentParser:
    """All commands with their lines of help; the chosen one with its options, whose module takes a second to import."""
    import rvjax

    about = tomllib.loads((resources.files("rvjax") / "cli.toml").read_text("utf-8"))
    parser = argparse.ArgumentParser("rvjax", None, about["description"], about["epilog"], formatter_class=_Formatter)
    parser.add_argument("--version", action="version", version=f"rvjax {rvjax.__version__}")
    subparsers = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for name, line in commands.COMMANDS.items():
        texts: dict[str, Any] = texts_of(commands.inputs_of(name)) if name == chosen else {}
        subparser = subparsers.add_parser(name, formatter_class=_Formatter, help=line, **texts)
        if name == chosen:
            add_options(subparser, commands.inputs_of(name))
            for flag, option in about["options"].items():
                subparser.add_argument(flag, **option)
    return parser


def texts_of(inputs: type[commands.Inputs]) -> dict[str, str]:
    """Description and epilog of a command."""
    text, examples, rest = inspect.cleandoc(inputs.__doc__ or "").partition("\n\nexamples:")
    return {"description": text, "epilog": f"{examples.strip()}{rest}\n"} if examples else {"description": text}


def add_options(parser: argparse.ArgumentParser, inputs: type[commands.Inputs]) -> None:
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
            parser.add_argument(about["flag"] or commands.flag_of(name), dest=name, **about["parser"])


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
        named = about["flag"] or commands.flag_of(field.name)
        if value is not None and about["ends"] is not None:
            _check_file(str(value) if named == "." else f"{named} {value}", str(value), about["ends"])
        if value is not None and about["unit"]:
            value = _size(value, named, about)
        given[field.name] = value
    return inputs(**given)


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


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Descriptions as they are written; on a terminal, in lines that fit."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        columns = terminal_width()
        return super()._fill_text(text if columns is None else refilled(text, columns), width, indent)


def _prepare(*, gpu: bool = False) -> None:
    """Settings that only the command line may make: float64, flags of XLA, no windows, kept programs and memory.

    Args:
        gpu: units may go to a GPU. All else stays on the processor, if there is one among the platforms of JAX.
    """
    given = os.environ.get("XLA_FLAGS", "")
    new = (flag for flag in xla_flags() if flag.split("=")[0] not in given)
    os.environ["XLA_FLAGS"] = " ".join([given, *new]).strip()
    for stream in (sys.stdout, sys.stderr):  # a name with an umlaut is no error on an ASCII terminal
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    os.environ.setdefault("MPLBACKEND", "Agg")
    # Matrices are small. On a busy computer threads wait for each other: `compensate` of 3,000 points with 40 steps
    # took 23.7 instead of 4.3 CPU s, and 83 instead of 15 s.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy loads
    gc.set_threshold(100_000, 20, 20)  # imports, tracing and drawing make objects that stay
    named = os.environ.get("JAX_PLATFORMS")
    if not (gpu or named):  # a GPU takes seconds to start
        os.environ["JAX_PLATFORMS"] = "cpu"
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # others use the GPU as well
    # XLA logs lines for every kept program: it takes preferences such as prefer-no-gather for instructions that the
    # processor lacks (the folder of kept programs is that of one processor). JAX sets "1", which its children inherit.
    quiet = os.environ.get("TF_CPP_MIN_LOG_LEVEL") != "0"
    if quiet:
        os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"  # before JAX loads
        logging.getLogger("matplotlib").setLevel(logging.ERROR)  # "building the font cache"
    import jax

    import rvjax
    from rvjax._jax import programs

    rvjax.enable_x64()
    if "," in named if named else gpu:
        jax.config.update("jax_default_device", "cpu")
    if quiet:
        jax.config.update("jax_logging_level", "CRITICAL")  # where JAX was there before
    programs.keep(rvjax.__version__)
    programs.keep_memory()


def xla_flags() -> list[str]:
    """Flags of XLA of the command line and the benchmarks."""
    # It stores what a long sum adds up and sums that in stages; in one pass a gradient of means takes two thirds of the
    # time. It starts every kernel of a loop on its own, unless the loop is small: as one function, a loaded unit takes
    # half of the time. It prefers 256-bit vectors; 512-bit ones are up to 1.8 times as fast where they exist.
    flags = ["--xla_disable_hlo_passes=tree_reduction_rewriter"]
    flags += ["--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=8000000"]
    with contextlib.suppress(OSError):
        flags += ["--xla_cpu_prefer_vector_width=512"] if "avx512f" in Path("/proc/cpuinfo").read_text() else []
    return flags
