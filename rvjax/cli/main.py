"""The command line: one parser for all commands, whose packages hold their options and help.

Bad input ends with one line on standard error and exit code 2; a study without a result
(infeasible requirements) with exit code 1.
"""

import argparse
import functools
import gc
import io
import logging
import os
import signal
import sys
import tomllib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from rvjax import commands as listed
from rvjax.base.words import refilled, terminal_width
from rvjax.commands import EXIT_BAD_INPUT, EXIT_OK, may_use_gpu, run, say


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = _parser()
    try:
        options = parser.parse_args(arguments)
        options.command = list(sys.argv[1:] if arguments is None else arguments)
    except SystemExit as stop:  # argparse wrote the error or the help
        return int(stop.code or 0)
    worker = getattr(options, "worker", None)
    _prepare(gpu=may_use_gpu(options.run.args[0], int(worker[2]) if worker else getattr(options, "processes", 1)))
    from rvjax.base.frames import MissingExtra
    from rvjax.base.progress import ended_by

    try:
        with ended_by(signal.SIGTERM, _Terminated()):
            code = options.run(options)
            sys.stdout.flush()  # here, and not at the end of the interpreter, which would complain
        return code
    except BrokenPipeError:  # the reader has closed the pipe, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer goes nowhere
        return EXIT_OK
    except (ValueError, OSError, MissingExtra) as error:
        say(f"rvjax: error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt as stop:
        file = getattr(options, "checkpoint", None) or getattr(options, "begun", lambda: None)()
        rest = f"the same command resumes from {file}" if file else "nothing was written"
        say(f"rvjax: interrupted, {rest}", file=sys.stderr)
        return 143 if isinstance(stop, _Terminated) else 130


class _Terminated(KeyboardInterrupt):
    """SIGTERM ends a command as Ctrl-C does; unfinished files are removed."""


def _parser() -> argparse.ArgumentParser:
    """All commands, their options and their help, as `cli.toml` lists them; an option without help is not shown."""
    import rvjax

    about = tomllib.loads((resources.files("rvjax.cli") / "cli.toml").read_text("utf-8"))
    as_written = _Formatter
    parser = argparse.ArgumentParser("rvjax", None, about["description"], about["epilog"], formatter_class=as_written)
    parser.add_argument("--version", action="version", version=f"rvjax {rvjax.__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    types: dict[str, Any] = {"count": _count, "int": int}
    for name in listed.COMMANDS:
        command = listed.about(name)
        command.pop("table", None)
        options = command.pop("options") | about["options"]
        subparser = commands.add_parser(name, formatter_class=as_written, **command)
        subparser.set_defaults(run=functools.partial(run, name))
        for flag, option in options.items():
            kind = {"type": types[option["type"]]} if "type" in option else {}
            subparser.add_argument(flag, **{"help": argparse.SUPPRESS} | option | kind)
    return parser


class _Formatter(argparse.RawDescriptionHelpFormatter):
    """Descriptions as they are written; on a terminal, in lines that fit."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        columns = terminal_width()
        return super()._fill_text(text if columns is None else refilled(text, columns), width, indent)


def _count(text: str) -> int:
    """A number such as 250000, 1_000_000 or 1e8."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (1 <= number <= 2**53 and number == int(number)):
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number of at least 1")
    return int(number)


def _prepare(*, gpu: bool = False) -> None:
    """Settings that only the command line may make: float64, flags of XLA, no windows, kept programs and memory.

    Args:
        gpu: units may go to a GPU. All else stays on the processor, if there is one among the platforms of JAX.
    """
    # XLA prefers 256-bit vectors; 512-bit ones are up to 1.8 times as fast where they exist. It stores what a long sum
    # adds up and sums that in stages; in one pass a gradient of means takes two thirds of the time.
    flags = ["--xla_disable_hlo_passes=tree_reduction_rewriter"]
    flags += ["--xla_cpu_prefer_vector_width=512"] if _has_avx512() else []
    given = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = " ".join([given, *(flag for flag in flags if flag.split("=")[0] not in given)]).strip()
    for stream in (sys.stdout, sys.stderr):  # a name with an umlaut is no error on an ASCII terminal
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    os.environ.setdefault("MPLBACKEND", "Agg")
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


def _has_avx512() -> bool:
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False
