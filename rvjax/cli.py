"""The command line: `rvjax allocate`, `rvjax report`, `rvjax montecarlo`, `rvjax reproduce`, `rvjax tradeoff`.

Bad input ends with one line on standard error and exit code 2; a question that has no answer
(infeasible requirements) with exit code 1.
"""

import argparse
import json
import os
import sys
import textwrap
import time
from collections.abc import Callable, Sequence
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
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description="What microns of manufacturing error do to the accuracy of a precision reducer,\n"
        "and which tolerances are the cheapest that still meet the requirement.",
        epilog="""examples:
  rvjax allocate                       the cheapest tolerances of an RV-40E, about 40 s
  rvjax report my-study.toml           the same of your own reducer, as one HTML page
  rvjax montecarlo corr --samples 1e5  what a batch of an oscillatory roller stage does
  rvjax reproduce --notes              the literature's figures beside computed ones
  rvjax COMMAND --help                 options, defaults and examples of a command

A study file asks one question of one reducer, in TOML with units in strings ("3.5 um"). Copy one that
comes with rvjax (rv-40e, corr; every results folder holds its study) and change it.

exit codes: 0 done; 1 no tolerances meet the requirements, or not with certainty; 2 bad input, one line on
standard error says what; 130 interrupted.
""",
    )
    parser.add_argument("--version", action="version", version=f"rvjax {rvjax.__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    allocate = _command(
        commands,
        "allocate",
        _allocate,
        "the cheapest tolerances that still meet the requirements",
        "Find the cheapest tolerances with which the required share of units meets every requirement, "
        "certify them on fresh random units, and write tables and pictures to a results folder.",
        """examples:
  rvjax allocate
  rvjax allocate my-study.toml --results results/first-try

The folder holds summary.txt, CSV tables, result.json (SI, with seed and versions), study.toml and pictures;
nothing is ever overwritten. exit code 1: no tolerances within the process ranges meet the requirements (the
summary says by how much the limits would have to move), or they could not be certified.
""",
    )
    _add_study(allocate)
    allocate.add_argument(
        "--results", metavar="DIR", help="new folder for the results (default: results/STUDY, numbered if it exists)"
    )
    allocate.add_argument("--quiet", action="store_true", help="no progress bars")

    report = _command(
        commands,
        "report",
        _report,
        "the same answer as one HTML page, for screen, phone and paper",
        "Find the cheapest tolerances as `allocate` does and write one self-contained HTML page: verdict, "
        "tolerances and cost, influence of each error, worst units, levels of computation, seed and versions.",
        """examples:
  rvjax report
  rvjax report my-study.toml --output page.html

The page holds its pictures, needs no network and no script. exit code 1: the page says that no tolerances meet
the requirements, or that they could not be certified.
""",
    )
    _add_study(report)
    report.add_argument(
        "--output",
        metavar="FILE.html",
        help="the page, replaced if it exists (default: report.html in a new folder results/STUDY)",
    )
    report.add_argument("--quiet", action="store_true", help="no progress bars")

    _add_montecarlo(commands)

    reproduce = _command(
        commands,
        "reproduce",
        _reproduce,
        "published figures beside computed ones, with a verdict",
        "Compute the published figures of the literature now and print them beside the printed ones. "
        "Takes about a minute, most of it compilation.",
        """examples:
  rvjax reproduce --notes
  rvjax reproduce --json > figures.json

verdicts: reproduced (within the printed rounding), reproduced_with_reading (under an interpretation that the
note names), close (within 10 %), contradicted (the figure cannot stand beside what the note names),
not_computable (the source leaves an input out). exit code 0 whatever the verdicts.
""",
    )
    reproduce.add_argument("--json", action="store_true", help="only a JSON list on standard output, for machines")
    reproduce.add_argument("--notes", action="store_true", help="print the reading or the reason under each figure")

    tradeoff = _command(
        commands,
        "tradeoff",
        _tradeoff,
        "speed against accuracy of every model, measured on this machine",
        "Measure time and error of the levels of every model side by side, and say which to use when. "
        "Takes less than two minutes on two idle cores, most of it compilation; all levels take about five.",
        """examples:
  rvjax tradeoff
  rvjax tradeoff --full --json here.json --picture here.png

Studies with an [accuracy] table take their levels from the measured table that comes with rvjax.
""",
    )
    tradeoff.add_argument("--json", metavar="FILE.json", help="write the table (default: only print it)")
    tradeoff.add_argument("--picture", metavar="FILE.png", help="draw error against time (default: no picture)")
    tradeoff.add_argument("--full", action="store_true", help="all levels, and more cases (default: the main ones)")
    tradeoff.add_argument("--seed", type=int, default=0, help="of the random cases (default: 0)")
    return parser


def _command(
    commands: Any, name: str, run: Callable[[argparse.Namespace], int], line: str, description: str, epilog: str
) -> argparse.ArgumentParser:
    command = commands.add_parser(
        name,
        help=line,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        description=textwrap.fill(description, 110),
        epilog=epilog,
    )
    command.set_defaults(run=run)
    return command


def _add_study(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "study",
        nargs="?",
        default="rv-40e",
        metavar="STUDY",
        help="a study file (.toml), or one that comes with rvjax: rv-40e (default), corr",
    )


def _add_montecarlo(commands: Any) -> None:
    montecarlo = _command(
        commands,
        "montecarlo",
        _montecarlo,
        "what a batch of units does, however large",
        "Draw units of a study with random errors and print the statistics of their responses. Memory "
        "stays the same however many units; all local devices share the work.",
        """examples:
  rvjax montecarlo my-study.toml
  rvjax montecarlo my-study.toml --samples 1e8 --checkpoint run.ckpt --json figures.json
  rvjax montecarlo rv-40e --sobol --samples 65536

Killed with a --checkpoint, the same command goes on and ends with the same bits; more --samples continue a
finished batch. A unit that fails counts as a reject, by reason. exit code 0 whatever the yield.
""",
    )
    _add_study(montecarlo)
    montecarlo.add_argument(
        "--samples",
        type=_count,
        metavar="N",
        help="units, such as 250000 or 1e8 (default: the study's certificate_samples)",
    )
    montecarlo.add_argument("--seed", type=int, help="of the random numbers (default: the study's)")
    montecarlo.add_argument("--sobol", action="store_true", help="scrambled Sobol points (default: random numbers)")
    montecarlo.add_argument("--chunk", type=_count, metavar="N", help="units at once (default: 32768)")
    montecarlo.add_argument(
        "--processes", type=_count, default=1, metavar="N", help="processes on this machine (default: 1)"
    )
    montecarlo.add_argument(
        "--checkpoint", metavar="FILE", help="go on from this file after an interruption; written once a second"
    )
    montecarlo.add_argument("--json", metavar="FILE.json", help="write the figures (default: only print)")
    montecarlo.add_argument("--save", metavar="FILE.npz", help="write the figures and the responses of every unit")
    montecarlo.add_argument("--quiet", action="store_true", help="no progress bar")
    montecarlo.add_argument("--worker", nargs=4, help=argparse.SUPPRESS)  # one of several processes: see `batch.work`


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
    from rvjax import study
    from rvjax.report import text
    from rvjax.study.answer import answer
    from rvjax.tolerances.atomic import check_writable

    question = study.load(options.study)
    folder = text.results_folder(options.results, question.name)
    check_writable(folder)
    found = answer(question, progress=not options.quiet)
    print(text.summary(found))
    text.write(found, folder)
    print(f"\nResults: {folder}")
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _report(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import page, text
    from rvjax.study.answer import answer
    from rvjax.tolerances.atomic import check_writable, write_atomically

    _check_files(options, output=".html")
    question = study.load(options.study)
    given = options.output is not None
    path = Path(options.output) if given else text.results_folder(None, question.name) / "report.html"
    check_writable(path)
    found = answer(question, progress=not options.quiet)
    content = page.page(found, options.study).encode("utf-8")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)
    print(text.headline(found))
    print(f"Report: {path}")
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _montecarlo(options: argparse.Namespace) -> int:
    from rvjax.report import batch as written
    from rvjax.study import batch

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
    written.write(found, options.study, figures=options.json, samples=options.save)
    print(written.summary(found, options.study))
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
    from rvjax import published
    from rvjax.report import text

    rows = published.reproduce()
    if options.json:
        print(json.dumps([row.as_json() for row in rows], indent=1, allow_nan=False))
    else:
        print(text.comparison_table(rows, notes=options.notes))
    return EXIT_OK


def _tradeoff(options: argparse.Namespace) -> int:
    from rvjax import levels, plotting

    _check_files(options, json=".json", picture=".png")
    started = time.perf_counter()
    table = levels.measure(
        quick=not options.full,
        seed=options.seed,
        say=lambda name: print(f"measuring {name}", file=sys.stderr, flush=True),
    )
    print(levels.report(table))
    if options.json:
        table.save(options.json)
    if options.picture:
        plotting.tradeoff(table).savefig(options.picture)
    print(f"\n{time.perf_counter() - started:.1f} s, compilation included")
    return EXIT_OK
