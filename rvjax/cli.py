"""The command line: `rvjax allocate`, `rvjax montecarlo`, `rvjax reproduce`, `rvjax tradeoff`.

Bad input ends with one line on standard error and exit code 2; a question that has no answer
(infeasible requirements) with exit code 1.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

EXIT_OK, EXIT_NO_ANSWER, EXIT_BAD_INPUT = 0, 1, 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = _parser()
    try:
        options = parser.parse_args(arguments)
        options.command = list(sys.argv[1:] if arguments is None else arguments)
    except SystemExit as stop:  # argparse has printed what is wrong, or the help
        return int(stop.code or 0)
    _prepare()
    try:
        return options.run(options)
    except (ValueError, OSError) as error:
        print(f"rvjax: error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        file = getattr(options, "checkpoint", None)
        rest = f"the same command goes on from {file}" if file else "nothing was written"
        print(f"rvjax: interrupted, {rest}", file=sys.stderr)
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

    _add_montecarlo(commands)

    reproduce = commands.add_parser(
        "reproduce",
        help="published figures beside computed ones, with a verdict",
        description="Compute the published figures of the literature now and print them beside the printed ones.",
    )
    reproduce.add_argument("--json", action="store_true", help="only a JSON list, for machines")
    reproduce.add_argument("--notes", action="store_true", help="print the reading or the reason under each figure")
    reproduce.set_defaults(run=_reproduce)

    tradeoff = commands.add_parser(
        "tradeoff",
        help="speed against accuracy of every model, measured on this machine",
        description="Measure time and error of every level of every model side by side, and say which to use when. "
        "Takes a minute or two on an idle machine, most of it compilation.",
    )
    tradeoff.add_argument("--json", metavar="FILE.json", help="write the table")
    tradeoff.add_argument("--picture", metavar="FILE.png", help="draw error against time")
    tradeoff.add_argument("--quick", action="store_true", help="fewer levels and cases")
    tradeoff.add_argument("--seed", type=int, default=0, help="of the random cases")
    tradeoff.set_defaults(run=_tradeoff)
    return parser


def _add_montecarlo(commands: Any) -> None:
    montecarlo = commands.add_parser(
        "montecarlo",
        help="what a batch of units does, however large",
        description="Draw units of a study with random errors and print the statistics of their responses. Memory "
        "stays the same however many units; all local devices share the work.",
    )
    montecarlo.add_argument(
        "study", nargs="?", default="rv-40e", metavar="STUDY", help="a study file (.toml), or the embedded rv-40e"
    )
    montecarlo.add_argument("--samples", type=_count, metavar="N", help="units (default: the study's certificate)")
    montecarlo.add_argument("--seed", type=int, help="of the random numbers (default: the study's)")
    montecarlo.add_argument("--sobol", action="store_true", help="scrambled Sobol points instead of random numbers")
    montecarlo.add_argument("--chunk", type=_count, metavar="N", help="units at once")
    montecarlo.add_argument("--processes", type=_count, default=1, metavar="N", help="processes on this machine")
    montecarlo.add_argument(
        "--checkpoint", metavar="FILE", help="go on from this file after an interruption; written once a second"
    )
    montecarlo.add_argument("--json", metavar="FILE.json", help="write the figures")
    montecarlo.add_argument("--save", metavar="FILE.npz", help="write the figures and the responses of every unit")
    montecarlo.add_argument("--quiet", action="store_true", help="no progress bar")
    montecarlo.add_argument("--worker", nargs=4, help=argparse.SUPPRESS)  # one of several processes: see `batch.work`
    montecarlo.set_defaults(run=_montecarlo)


def _count(text: str) -> int:
    """A number such as 250000, 1_000_000 or 1e8."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (1 <= number <= 2**53 and number == int(number)):
        raise argparse.ArgumentTypeError(f"{text!r}: must be a whole number of at least 1")
    return int(number)


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


def _montecarlo(options: argparse.Namespace) -> int:
    from rvjax import batch

    _check_files(options, json=".json", save=".npz")
    wanted = batch.Batch(
        study=options.study,
        samples=options.samples,
        seed=options.seed,
        sobol=options.sobol,
        chunk=options.chunk or batch.CHUNK,
        checkpoint=options.checkpoint,
        keep=options.save is not None,
        progress=not options.quiet,
    )
    if options.worker:
        address, number, processes, target = options.worker
        batch.work(wanted, address, int(number), int(processes), target)
        return EXIT_OK
    started = time.perf_counter()
    found = batch.run(wanted) if options.processes == 1 else batch.run_in_processes(options.command, options.processes)
    seconds = time.perf_counter() - started
    batch.write(found, options.study, figures=options.json, samples=options.save)
    print(batch.summary(found, options.study))
    print(f"\n{seconds:.1f} s, start and compilation included")
    return EXIT_OK


def _check_files(options: argparse.Namespace, **endings: str) -> None:
    """Refuse a file that could not be written, before any work is done."""
    for option, ending in endings.items():
        path = getattr(options, option)
        if path is not None and not path.endswith(ending):
            raise ValueError(f"--{option} {path}: must end with {ending}")
        if path is not None and not Path(path).absolute().parent.is_dir():
            raise ValueError(f"--{option} {path}: there is no such folder")


def _reproduce(options: argparse.Namespace) -> int:
    from rvjax import published, report

    rows = published.reproduce()
    if options.json:
        print(json.dumps([row.as_json() for row in rows], indent=1, allow_nan=False))
    else:
        print(report.comparison_table(rows, notes=options.notes))
    return EXIT_OK


def _tradeoff(options: argparse.Namespace) -> int:
    from rvjax import plotting, tradeoff

    _check_files(options, json=".json", picture=".png")
    started = time.perf_counter()
    table = tradeoff.measure(
        quick=options.quick,
        seed=options.seed,
        say=lambda name: print(f"measuring {name}", file=sys.stderr, flush=True),
    )
    print(tradeoff.report(table))
    if options.json:
        table.save(options.json)
    if options.picture:
        plotting.tradeoff(table).savefig(options.picture)
    print(f"\n{time.perf_counter() - started:.1f} s, compilation included")
    return EXIT_OK
