"""The command line: `rvjax allocate`, `rvjax reproduce`.

Bad input ends with one line on standard error and exit code 2; a question that has no answer
(infeasible requirements) with exit code 1.
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path

EXIT_OK, EXIT_NO_ANSWER, EXIT_BAD_INPUT = 0, 1, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = _parser()
    try:
        options = parser.parse_args(arguments)
    except SystemExit as stop:  # argparse has printed what is wrong, or the help
        return int(stop.code or 0)
    _prepare()
    try:
        return options.run(options)
    except (ValueError, OSError) as error:
        print(f"rvjax: error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print("rvjax: interrupted, nothing was written", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    import rvjax

    parser = argparse.ArgumentParser(
        prog="rvjax",
        description="Accuracy of precision reducers: errors, tolerances and what they cost.",
        epilog="Exit codes: 0 done, 1 no tolerances meet the requirements, 2 bad input.",
    )
    parser.add_argument("--version", action="version", version=f"rvjax {rvjax.__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    allocate = commands.add_parser(
        "allocate",
        help="the cheapest tolerances that still meet the requirements",
        description="Find the cheapest tolerances with which the required share of units meets every requirement, "
        "certify them on fresh random units, and write tables and pictures to a results folder.",
    )
    allocate.add_argument(
        "study",
        nargs="?",
        default="rv-40e",
        metavar="STUDY",
        help="a study file (.toml), or the embedded rv-40e (default)",
    )
    allocate.add_argument(
        "--results", metavar="DIR", help="new folder for the results (default: results/STUDY, numbered if it exists)"
    )
    allocate.add_argument("--quiet", action="store_true", help="no progress bars")
    allocate.set_defaults(run=_allocate)

    reproduce = commands.add_parser(
        "reproduce",
        help="published figures beside computed ones, with a verdict",
        description="Compute the published figures of the literature now and print them beside the printed ones.",
    )
    reproduce.add_argument("--json", action="store_true", help="only a JSON list, for machines")
    reproduce.add_argument("--notes", action="store_true", help="print the reading or the reason under each figure")
    reproduce.set_defaults(run=_reproduce)
    return parser


def _prepare() -> None:
    """Settings that only the command line may make: float64, wide vectors, headless pictures."""
    if _has_avx512() and "xla_cpu_prefer_vector_width" not in os.environ.get("XLA_FLAGS", ""):
        # XLA prefers 256-bit vectors; 512-bit ones are up to 1.8 times as fast where they exist.
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_prefer_vector_width=512".strip()
    os.environ.setdefault("MPLBACKEND", "Agg")
    import rvjax

    rvjax.enable_x64()


def _has_avx512() -> bool:
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


def _allocate(options: argparse.Namespace) -> int:
    from rvjax import report, study
    from rvjax.answer import answer

    question = study.load(options.study)
    folder = report.results_folder(options.results, question.name)
    found = answer(question, progress=not options.quiet)
    print(report.summary(found))
    report.write(found, folder)
    print(f"\nResults: {folder}")
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _reproduce(options: argparse.Namespace) -> int:
    from rvjax import published, report

    rows = published.reproduce()
    if options.json:
        print(json.dumps([row.as_json() for row in rows], indent=1, allow_nan=False))
    else:
        print(report.comparison_table(rows, notes=options.notes))
    return EXIT_OK
