"""The command line: one function a command; `cli.toml` has their options and help.

Bad input ends with one line on standard error and exit code 2; a question that has no answer
(infeasible requirements) with exit code 1.
"""

import argparse
import json
import os
import signal
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Sequence
from importlib import resources
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
    before = _on_terminate()
    try:
        code = options.run(options)
        sys.stdout.flush()  # here, and not at the end of the interpreter, which would complain
        return code
    except BrokenPipeError:  # whoever reads has enough, as `head` has
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left in the buffer goes nowhere
        return EXIT_OK
    except (ValueError, OSError) as error:
        _say(f"rvjax: error: {' '.join(str(error).split())}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt as stop:
        file = getattr(options, "checkpoint", None) or getattr(options, "begun", lambda: None)()
        rest = f"the same command goes on from {file}" if file else "nothing was written"
        _say(f"rvjax: interrupted, {rest}", file=sys.stderr)
        return 143 if isinstance(stop, _Terminated) else 130
    finally:
        if before is not None:
            signal.signal(signal.SIGTERM, before)


class _Terminated(KeyboardInterrupt):
    """SIGTERM ends a command as Ctrl-C does: what it has begun is cleared away."""


def _on_terminate() -> Any:
    """Let SIGTERM raise; returns the handler before, or None outside the main thread."""
    if threading.current_thread() is not threading.main_thread():
        return None

    def stop(*_: Any) -> None:
        raise _Terminated

    return signal.signal(signal.SIGTERM, stop)


def _say(text: str, file: Any = None) -> None:
    """Print; what would speak to the terminal rather than to a person (escape sequences in a key) is spelled out."""
    lines = (
        "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
        for line in text.split("\n")
    )
    print("\n".join(lines), file=file)


def _parser() -> argparse.ArgumentParser:
    """All commands, their options and their help, as `cli.toml` lists them."""
    import rvjax

    about = tomllib.loads((resources.files("rvjax") / "cli.toml").read_text("utf-8"))
    as_written = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("rvjax", None, about["description"], about["epilog"], formatter_class=as_written)
    parser.add_argument("--version", action="version", version=f"rvjax {rvjax.__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    run: dict[str, Any] = dict(init=_init, check=_check, allocate=_allocate, report=_report, montecarlo=_montecarlo)
    run |= dict(compare=_compare, reproduce=_reproduce, tradeoff=_tradeoff)
    run |= dict(identify=_identify, assemble=_assemble, compensate=_compensate)
    types: dict[str, Any] = {"count": _count, "int": int}
    for name, command in about["command"].items():
        options = command.pop("options")
        subparser = commands.add_parser(name, formatter_class=as_written, **command)
        subparser.set_defaults(run=run[name])
        for flag, option in options.items():
            subparser.add_argument(flag, **option | ({"type": types[option["type"]]} if "type" in option else {}))
    # One of several processes of a batch: see `study.batch.work`.
    commands.choices["montecarlo"].add_argument("--worker", nargs=4, help=argparse.SUPPRESS)
    return parser


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
    """Settings that only the command line may make: float64, wide vectors, headless pictures, kept programs."""
    if _has_avx512() and "xla_cpu_prefer_vector_width" not in os.environ.get("XLA_FLAGS", ""):
        # XLA prefers 256-bit vectors; 512-bit ones are up to 1.8 times as fast where they exist.
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_prefer_vector_width=512".strip()
    os.environ.setdefault("MPLBACKEND", "Agg")
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA logs two lines for every kept program; before JAX loads
    import rvjax
    from rvjax import programs

    rvjax.enable_x64()
    programs.keep(rvjax.__version__)


def _has_avx512() -> bool:
    try:
        return "avx512f" in Path("/proc/cpuinfo").read_text()
    except OSError:
        return False


def _init(options: argparse.Namespace) -> int:
    from rvjax.study import template
    from rvjax.tolerances.atomic import check_writable, write_atomically

    _check_files(options, file=".toml")
    path = Path(options.file)
    if path.exists():
        raise ValueError(f"{options.file}: exists already; name a new file")
    check_writable(path)
    write_atomically(path, template.written(options.base).encode("utf-8"))
    _say(f"{options.file}: a study of the {options.base} to change. Next: rvjax check {options.file}")
    return EXIT_OK


def _check(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import check

    _check_files(options, picture=".png")
    question = study.load(options.study, solve=False)
    _tell(options, lambda: check.checked(question), lambda: check.as_json(question))
    if options.picture:
        check.drawn(question, options.picture)
    return EXIT_OK


def _tell(options: argparse.Namespace, text: Callable[[], str], data: Callable[[], dict[str, Any]]) -> None:
    """The result on standard output, as the option asks: for a person, or as one JSON object and nothing else."""
    if options.format == "json":
        print(json.dumps(data(), indent=1, allow_nan=False))
    else:
        _say(text())


def _forewarn(question: Any) -> None:
    """Before any work: numbers that look like a slip, and how each response with an accuracy will be computed."""
    from rvjax.report import check

    for line in question.doubts:
        _say(f"rvjax: warning: {line}", file=sys.stderr)
    if question.accuracy:
        for line in [*check.level_lines(question), check.expected(question)]:
            _say(f"rvjax: {line}", file=sys.stderr)


def _allocate(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import again, text
    from rvjax.study.answer import answer
    from rvjax.tolerances.atomic import check_writable

    if not options.fresh:
        kept = again.folder(study.load(options.study, solve=False), options.results)
        if kept is not None:
            said = f"Unchanged since {kept} was written, which holds this answer; --fresh computes it anew."
            told = (kept / "summary.txt").read_text("utf-8") + said
            _tell(
                options, lambda: told, lambda: json.loads((kept / "result.json").read_text()) | {"results": str(kept)}
            )
            return EXIT_OK if again.status(kept) == "OPTIMAL" else EXIT_NO_ANSWER
    question = study.load(options.study, solve=False)  # the answer itself refuses a nominal unit without a solution
    folder = text.results_folder(options.results, question.name)
    check_writable(folder)
    _forewarn(question)
    journal = again.journal(question, folder)
    options.begun = lambda: journal.folder if journal and journal.folder.exists() else None
    found = answer(question, progress=not options.quiet, journal=journal)
    if options.format == "text":  # before the folder is made: whatever fails there, the answer has been told
        _say(text.summary(found))
    folder = text.write(found, folder)
    if journal:
        journal.clear()
    _tell(options, lambda: f"\nResults: {folder}", lambda: text.as_json(found) | {"results": str(folder)})
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _report(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import page, text
    from rvjax.report.surrogate import surrogate
    from rvjax.study.answer import answer
    from rvjax.tolerances.atomic import check_writable, write_atomically

    _check_files(options, output=".html")
    question = study.load(options.study, solve=False)  # the answer itself refuses a nominal unit without a solution
    given = options.output is not None
    path = Path(options.output) if given else text.results_folder(None, question.name) / "report.html"
    check_writable(path)
    _forewarn(question)
    found = answer(question, progress=not options.quiet)
    content = page.page(found, options.study, surrogate(found)).encode("utf-8")
    if not given:
        path = text.new_folder(path.parent) / path.name
    write_atomically(path, content)
    _say(text.headline(found))
    _say(f"Report: {path}")
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _montecarlo(options: argparse.Namespace) -> int:
    from rvjax.report import batch as written
    from rvjax.study import batch

    _check_files(options, json=".json", save=".npz")

    def asked() -> batch.Batch:
        return batch.Batch(
            study=batch.question(options.study, options.worker),
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
        batch.work(asked, address, int(number), int(processes), target)
        return EXIT_OK
    wanted = asked()
    question = wanted.study  # as it was read before the run: the file may change meanwhile
    _forewarn(question)
    started = time.perf_counter()
    if options.processes == 1:
        found = batch.run(wanted)
    else:
        found = batch.run_in_processes(options.command, options.processes, text=question.text)
    seconds = time.perf_counter() - started
    written.write(found, question, options.study, figures=options.json, samples=options.save)
    after = f"\n\n{seconds:.1f} s, start and compilation included"
    _tell(options, lambda: written.summary(found, question) + after, lambda: written.as_json(found, question))
    return EXIT_OK


def _identify(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import identified as told
    from rvjax.report import identified_page, text
    from rvjax.study import identified, measured, problem
    from rvjax.tolerances.atomic import check_writable

    question = study.load(options.study)
    asked = problem.asked_of(question)
    data = measured.read(options.data, asked.columns) if options.data else None
    if options.check:
        found = identified.check(question, data)
    elif data is None:
        raise ValueError("no data: name at least one CSV file, or ask with --check what a bench could tell apart")
    else:
        folder = text.results_folder(options.results, question.name)
        check_writable(folder)
        found = identified.answer(question, data, draws=options.sample)
        pictures = ((f"{picture.name}.png", picture.content) for picture in identified_page.pictures(found))
        page = ("report.html", identified_page.page(found, options.study, options.data).encode())
        folder = text.write_files(told.files(found, options.data, (page, *pictures)), folder)
    if options.json:
        print(json.dumps(told.as_json(found), indent=1, allow_nan=False))
    else:
        _say(told.summary(found))
        if not options.check:
            _say(f"\nResults: {folder}")
    return EXIT_NO_ANSWER if found.adequate is False else EXIT_OK


def _compare(options: argparse.Namespace) -> int:
    from rvjax.report import compare

    first, second = compare.result(options.first), compare.result(options.second)
    if options.format == "json":
        print(json.dumps(compare.compared(first, second), indent=1, allow_nan=False))
    else:
        _say(f"A: {options.first}\nB: {options.second}\n\n{compare.text(first, second)}")
    return EXIT_OK


def _check_files(options: argparse.Namespace, **endings: str) -> None:
    """Refuse a file that could not be written, before any work is done."""
    for option, ending in endings.items():
        path = getattr(options, option)
        name = path if option == "file" else f"--{option} {path}"
        if path is not None and not path.endswith(ending):
            raise ValueError(f"{name}: must end with {ending}")
        if path is not None and not Path(path).absolute().parent.is_dir():
            raise ValueError(f"{name}: there is no such folder")


def _reproduce(options: argparse.Namespace) -> int:
    from rvjax import published
    from rvjax.report import text

    rows = published.reproduce(say=lambda text: print(text, file=sys.stderr, flush=True))
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
    after = f"\n\n{time.perf_counter() - started:.1f} s, compilation included"
    _tell(options, lambda: levels.report(table) + after, table.as_json)
    if options.json:
        table.save(options.json)
    if options.picture:
        plotting.tradeoff(table).savefig(options.picture)
    return EXIT_OK


def _assemble(options: argparse.Namespace) -> int:
    from rvjax import assembly, study
    from rvjax.report import assembly as written
    from rvjax.report import text
    from rvjax.study.assembly import bench
    from rvjax.study.prices import prices
    from rvjax.tolerances.atomic import check_writable

    question = study.load(options.study)
    folder = text.results_folder(options.results, f"{question.name}-assembly")
    check_writable(folder)
    parts = bench(question, options.parts)
    asked = question.assembly
    found = assembly.plan(
        parts.response,
        parts.kinds,
        objective=asked.objective,
        requirement=parts.requirement,
        draws=asked.draws,
        certificate_draws=asked.certificate_draws,
        seed=question.seed,
    )
    _say(written.summary(found, parts, question))
    costs = prices(question, parts) if options.prices else []
    _say(written.price_text(costs))
    folder = written.write(found, parts, question, options.parts, folder, costs)
    _say(f"\nResults: {folder}")
    return EXIT_OK if found.status != "INFEASIBLE" else EXIT_NO_ANSWER


def _compensate(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import compensation as written
    from rvjax.report import text
    from rvjax.study.compensation import corrections
    from rvjax.study.values import quantity
    from rvjax.tolerances.atomic import check_writable

    if options.export is not None:
        written.check_export(options.export)
    question = study.load(options.study)
    folder = text.results_folder(options.results, f"{question.name}-compensation")
    check_writable(folder)
    found = corrections(
        question,
        options.data,
        angle_sd=quantity(options.angle_sd, "rad", "--angle-sd"),
        count=options.count,
        first_order=options.first_order,
    )
    points = options.points or written.POINTS
    _say(written.summary(found, question, seed=question.seed))
    tables = written.tables(found, points, options.side)
    folder = written.write(found, tables, question, options.data, folder)
    for path in written.export_all(found, tables, options.export, question.seed) if options.export else ():
        _say(f"Table: {path}")
    _say(f"\nResults: {folder}")
    return EXIT_OK
