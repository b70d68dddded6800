"""The command line: one function a command; `cli.toml` has their options and help.

Bad input ends with one line on standard error and exit code 2; a question that has no answer
(infeasible requirements) with exit code 1.
"""

import argparse
import io
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

READING, WRITING = "reading the study", "tables and pictures"  # phases
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
    except (ValueError, OSError, ImportError) as error:  # the last: an extra that is not installed
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
    from rvjax import phases

    lines = (
        "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
        for line in text.split("\n")
    )
    with phases.aside():
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
    run |= dict(budget=_budget, compare=_compare, reproduce=_reproduce, tradeoff=_tradeoff)
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
    """Settings that only the command line may make: float64, flags of XLA, headless pictures, kept programs."""
    # XLA prefers 256-bit vectors; 512-bit ones are up to 1.8 times as fast where they exist. It stores what a long sum
    # adds up and sums that in stages; in one pass a gradient of means takes two thirds of the time.
    flags = ["--xla_disable_hlo_passes=tree_reduction_rewriter"]
    flags += ["--xla_cpu_prefer_vector_width=512"] if _has_avx512() else []
    given = os.environ.get("XLA_FLAGS", "")
    os.environ["XLA_FLAGS"] = " ".join([given, *(flag for flag in flags if flag.split("=")[0] not in given)]).strip()
    for stream in (sys.stdout, sys.stderr):  # a name with an umlaut is no error where a terminal knows ASCII alone
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
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
    said = f"{options.file}: a study of the {options.base} to change. Next: rvjax check {options.file}"
    _tell(options, lambda: said, lambda: {"study": options.file, "base": options.base})
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


def _tell(options: argparse.Namespace, text: Callable[[], str], data: Callable[[], dict[str, Any] | list[Any]]) -> None:
    """The result on standard output, as the option asks: for a person, or as one JSON value and nothing else."""
    if _for_machines(options):
        print(json.dumps(data(), indent=1, allow_nan=False))
    else:
        _say(text())


def _for_machines(options: argparse.Namespace) -> bool:
    """Whether `--format json`, or the older `--json` of a command where it names no file, was given."""
    return options.format == "json" or getattr(options, "json", None) is True


def _forewarn(question: Any) -> None:
    """Before any work: numbers that look like a slip, and how each response with an accuracy will be computed."""
    from rvjax.report import check

    for line in question.doubts:
        _say(f"rvjax: warning: {line}", file=sys.stderr)
    if question.accuracy:
        for line in [*check.level_lines(question), check.expected(question)]:
            _say(f"rvjax: {line}", file=sys.stderr)


def _allocate(options: argparse.Namespace) -> int:
    from rvjax import phases, study
    from rvjax.report import again, check, folders, text
    from rvjax.study.answer import answer
    from rvjax.tolerances.atomic import check_writable

    asked = study.load(options.study, solve=False)
    kept = None if options.fresh else again.folder(asked, options.results)
    if kept is not None:
        said = f"Unchanged since {kept} was written, which holds this answer; --fresh computes it anew."
        told = (kept / "summary.txt").read_text("utf-8") + said
        _tell(options, lambda: told, lambda: json.loads((kept / "result.json").read_text()) | {"results": str(kept)})
        return EXIT_OK if again.status(kept) == "OPTIMAL" else EXIT_NO_ANSWER
    folder = folders.results_folder(options.results, asked.name)
    check_writable(folder)
    _forewarn(asked)
    journal = again.journal(asked, folder)
    options.begun = lambda: journal.folder if journal and journal.folder.exists() else None
    with phases.shown(check.phases_of(asked, READING, WRITING), quiet=options.quiet):
        phases.begin(READING)
        # The answer itself refuses a nominal unit without a solution.
        found = answer(asked, progress=not options.quiet, journal=journal)
        if options.format == "text":  # before the folder is made: whatever fails there, the answer has been told
            _say(text.summary(found))
        phases.begin(WRITING)
        folder = folders.write(found, folder)
    if journal:
        journal.clear()
    _tell(options, lambda: f"\nResults: {folder}", lambda: text.as_json(found) | {"results": str(folder)})
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _report(options: argparse.Namespace) -> int:
    from rvjax import phases, study
    from rvjax.report import check, folders, page, text
    from rvjax.report.surrogate import surrogate
    from rvjax.study.answer import answer
    from rvjax.study.budget import budget_if_any
    from rvjax.tolerances.atomic import check_writable, write_atomically

    _check_files(options, output=".html")
    asked = study.load(options.study, solve=False)
    given = options.output is not None
    path = Path(options.output) if given else folders.results_folder(None, asked.name) / "report.html"
    check_writable(path)
    _forewarn(asked)
    sliders, writing = "numbers behind the sliders", "the page"
    with phases.shown(check.phases_of(asked, READING, sliders, writing), quiet=options.quiet):
        phases.begin(READING)
        found = answer(asked, progress=not options.quiet)
        phases.begin(sliders)
        moved = surrogate(found)
        owners = budget_if_any(asked, found.allocation.tolerances)
        phases.begin(writing)
        content = page.page(found, options.study, moved, owners, date=time.strftime("%Y-%m-%d")).encode("utf-8")
    if not given:
        path = folders.new_folder(path.parent) / path.name
    write_atomically(path, content)
    _tell(
        options,
        lambda: f"{text.headline(found)}\nReport: {path}",
        lambda: text.as_json(found) | {"report": str(path)},
    )
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def _budget(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import budget as written
    from rvjax.report import folders
    from rvjax.study.values import quantity
    from rvjax.tolerances.atomic import check_writable

    question = study.load(options.study)
    loads = {torque: quantity(torque, "N m", "--torque") for torque in options.torque or ()}
    if len(set(loads.values())) < len(options.torque or ()):
        raise ValueError(f"--torque {', '.join(options.torque)}: each torque once")
    folder = folders.results_folder(options.results, f"{question.name}-budget")
    check_writable(folder)
    _forewarn(question)
    found = study.error_budget(
        question, output=options.output, loads=loads or None, samples=options.samples, seed=options.seed
    )
    folder = written.write(found, question, folder)
    _tell(
        options,
        lambda: f"Study {question.name}\n{written.summary(found)}\n\nResults: {folder}",
        lambda: written.as_json(found, question) | {"results": str(folder)},
    )
    return EXIT_OK


def _montecarlo(options: argparse.Namespace) -> int:
    from rvjax import phases
    from rvjax.report import batch as written
    from rvjax.study import batch
    from rvjax.tolerances.propagation.unit_file import ENDINGS, UnitFile

    _check_files(options, json=".json", save=(".npz", *ENDINGS))
    table = options.save if options.save and options.save.endswith(ENDINGS) else None
    if options.save_errors and table is None:
        raise ValueError(f"--save-errors: needs --save FILE with {' or '.join(ENDINGS)}, not {options.save}")
    if table is not None:
        UnitFile(table)  # says before any work that an extra is missing

    def asked() -> batch.Batch:
        question = batch.question(options.study, options.worker)
        return batch.Batch(
            study=question,
            samples=options.samples,
            seed=options.seed,
            sobol=options.sobol,
            chunk=options.chunk or batch.CHUNK,
            checkpoint=options.checkpoint,
            keep=options.save is not None and table is None,
            save=table
            and batch.table_of(table, question, options.study, errors=options.save_errors, worker=options.worker),
            progress=not options.quiet,
        )

    if options.worker:
        address, number, processes, target = options.worker
        batch.work(asked, address, int(number), int(processes), target)
        return EXIT_OK
    started, drawing = time.perf_counter(), "drawing units"
    expected = {READING: 6.0, drawing: 0.0}  # each process of several has a line of its own
    with phases.shown(expected, counted=drawing, quiet=options.quiet or options.processes > 1):
        phases.begin(READING)
        wanted = asked()
        question = wanted.study  # as it was read before the run: the file may change meanwhile
        _forewarn(question)
        phases.begin(drawing)
        if options.processes == 1:
            found = batch.run(wanted)
        else:
            found = batch.run_in_processes(
                options.command, options.processes, text=question.text, table=table, chunk=wanted.chunk
            )
    seconds = time.perf_counter() - started
    written.write(found, question, options.study, figures=options.json, samples=options.save if wanted.keep else None)
    after = f"\n\n{seconds:.1f} s, start and compilation included"
    _tell(options, lambda: written.summary(found, question) + after, lambda: written.as_json(found, question))
    return EXIT_OK


def _identify(options: argparse.Namespace) -> int:
    from rvjax import phases, study
    from rvjax.report import folders, identified_page
    from rvjax.report import identified as told
    from rvjax.study import identified, measured, problem
    from rvjax.tolerances.atomic import check_writable

    coming = (identified.SEEING, identified.RANKING) if options.check else (*identified.PHASES, WRITING)
    with phases.shown(dict.fromkeys((READING, *coming), 0.0), quiet=options.quiet):
        phases.begin(READING)
        question = study.load(options.study)
        asked = problem.asked_of(question)
        data = measured.read(options.data, asked.columns) if options.data else None
        if options.check:
            found = identified.check(question, data)
        elif data is None:
            raise ValueError("no data: name at least one CSV file, or ask with --check what a bench could tell apart")
        else:
            folder = folders.results_folder(options.results, question.name)
            check_writable(folder)
            found = identified.answer(question, data, draws=options.sample)
            phases.begin(WRITING)
            pictures = ((f"{picture.name}.png", picture.content) for picture in identified_page.pictures(found))
            page = ("report.html", identified_page.page(found, options.study, options.data).encode())
            folder = folders.write_files(told.files(found, options.data, (page, *pictures)), folder)
    after = "" if options.check else f"\n\nResults: {folder}"
    _tell(options, lambda: told.summary(found) + after, lambda: told.as_json(found))
    return EXIT_NO_ANSWER if found.adequate is False else EXIT_OK


def _compare(options: argparse.Namespace) -> int:
    from rvjax import study
    from rvjax.report import compare, crossed
    from rvjax.study.crossed import crossed as judge

    if options.second is None and options.on is None:
        raise ValueError("B is missing: name two results folders, or one and with --on the study that judges it")
    if options.samples is not None and options.on is None:
        raise ValueError(f"--samples {options.samples}: units are drawn for --on STUDY alone")
    paths = {letter: path for letter, path in zip("AB", (options.first, options.second)) if path is not None}
    results = [compare.result(path) for path in paths.values()]
    told = "\n".join(f"{letter}: {path}" for letter, path in paths.items())
    data: dict[str, Any] = {}
    if len(results) == 2:
        told, data = f"{told}\n\n{compare.text(*results)}", compare.compared(*results)
    if options.on is not None:
        question = study.load(options.on, solve=False)  # a unit that fails counts among the others
        answers = {letter: crossed.answered(path) for letter, path in paths.items()}
        _forewarn(question)
        found = {letter: judge(question, one, samples=options.samples) for letter, (_, one) in answers.items()}
        own = {letter: answer for letter, (answer, _) in answers.items()}
        told, data = f"{told}\n\n{crossed.summary(found, own)}", data | {"on": crossed.as_json(found, own)}
    _tell(options, lambda: told, lambda: data)
    return EXIT_OK


def _check_files(options: argparse.Namespace, **endings: str | tuple[str, ...]) -> None:
    """Refuse a file that could not be written, before any work is done."""
    for option, ending in endings.items():
        path = getattr(options, option)
        name = path if option == "file" else f"--{option} {path}"
        if path is not None and not path.endswith(ending):
            raise ValueError(f"{name}: must end with {ending if isinstance(ending, str) else ' or '.join(ending)}")
        if path is not None and not Path(path).absolute().parent.is_dir():
            raise ValueError(f"{name}: there is no such folder")


def _reproduce(options: argparse.Namespace) -> int:
    from rvjax import published
    from rvjax.report import text

    rows = published.reproduce(say=lambda text: print(text, file=sys.stderr, flush=True))
    _tell(options, lambda: text.comparison_table(rows, notes=options.notes), lambda: [row.as_json() for row in rows])
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
    from rvjax import assembly, phases, study
    from rvjax.report import assembly as written
    from rvjax.report import folders
    from rvjax.study.assembly import bench
    from rvjax.study.prices import prices
    from rvjax.tolerances.atomic import check_writable

    matching, pricing = "which part goes with which", "prices of tolerances"
    coming = (matching, *([pricing] if options.prices else []), WRITING)
    with phases.shown(dict.fromkeys((READING, *coming), 0.0), quiet=options.quiet):
        phases.begin(READING)
        question = study.load(options.study)
        folder = folders.results_folder(options.results, f"{question.name}-assembly")
        check_writable(folder)
        parts = bench(question, options.parts)
        asked = question.assembly
        phases.begin(matching)
        found = assembly.plan(
            parts.response,
            parts.kinds,
            objective=asked.objective,
            requirement=parts.requirement,
            draws=asked.draws,
            certificate_draws=asked.certificate_draws,
            seed=question.seed,
        )
        if options.format == "text":
            _say(written.summary(found, parts, question))
        phases.begin(pricing)
        costs = prices(question, parts) if options.prices else []
        phases.begin(WRITING)
        folder = written.write(found, parts, question, options.parts, folder, costs)
    after = f"{written.price_text(costs)}\n\nResults: {folder}"
    data = written.as_json(found, parts, question, costs) | {"results": str(folder)}
    _tell(options, lambda: after, lambda: data)
    return EXIT_OK if found.status != "INFEASIBLE" else EXIT_NO_ANSWER


def _compensate(options: argparse.Namespace) -> int:
    from rvjax import phases, study
    from rvjax.report import compensation as written
    from rvjax.report import folders
    from rvjax.study.compensation import corrections
    from rvjax.study.values import quantity
    from rvjax.tolerances.atomic import check_writable

    if options.export is not None:
        written.check_export(options.export)
    correcting = "orders of the curves"
    with phases.shown(dict.fromkeys((READING, correcting, WRITING), 0.0), quiet=options.quiet):
        phases.begin(READING)
        question = study.load(options.study)
        folder = folders.results_folder(options.results, f"{question.name}-compensation")
        check_writable(folder)
        phases.begin(correcting)
        found = corrections(
            question,
            options.data,
            angle_sd=quantity(options.angle_sd, "rad", "--angle-sd"),
            count=options.count,
            first_order=options.first_order,
        )
        points = options.points or written.POINTS
        if options.format == "text":
            _say(written.summary(found, question, seed=question.seed))
        phases.begin(WRITING)
        tables = written.tables(found, points, options.side)
        folder = written.write(found, tables, question, options.data, folder)
    paths = [str(p) for p in written.export_all(found, tables, options.export, question.seed)] if options.export else []
    data = written.as_json(found, tables, question) | {"tables": paths, "results": str(folder)}
    _tell(options, lambda: "\n".join([*(f"Table: {path}" for path in paths), f"\nResults: {folder}"]), lambda: data)
    return EXIT_OK
