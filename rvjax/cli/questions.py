"""The commands that ask what a study answers, or what rvjax knows: one function a command."""

import argparse
import json
import sys
import time
from pathlib import Path

from rvjax.commands import EXIT_NO_ANSWER, EXIT_OK, READING, WRITING, check_files, forewarn, say, share_cores, tell


def allocate(options: argparse.Namespace) -> int:
    """The cheapest tolerances that still meet the requirements."""
    from rvjax import progress, study
    from rvjax.commands import forecast
    from rvjax.report import again, folders, text
    from rvjax.study.answer import answer

    asked = study.load(options.study, solve=False)
    if asked.costly:
        share_cores(1)
    kept = None if options.fresh else again.folder(asked, options.results)
    if kept is not None:
        said = f"Unchanged since {kept} was written, which holds this answer; --fresh computes it anew."
        told = (kept / "summary.txt").read_text("utf-8") + said
        tell(options, lambda: told, lambda: json.loads((kept / "result.json").read_text()) | {"results": str(kept)})
        return EXIT_OK if again.status(kept) == "OPTIMAL" else EXIT_NO_ANSWER
    folder = folders.results_folder(options.results, asked.name)
    forewarn(asked)
    memo = again.memo(asked, folder)
    options.begun = lambda: memo.folder if memo and memo.folder.exists() else None
    with progress.shown(forecast.phases_of(asked, READING, WRITING), quiet=options.quiet):
        progress.begin(READING)
        # The answer itself refuses a nominal unit without a solution.
        found = answer(asked, progress=not options.quiet, memo=memo)
        if options.format == "text":  # before the folder is made: whatever fails there, the answer has been told
            say(text.summary(found))
        progress.begin(WRITING)
        folder = folders.write(found, folder)
    if memo:
        memo.clear()
    tell(options, lambda: f"\nResults: {folder}", lambda: text.as_json(found) | {"results": str(folder)})
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def report(options: argparse.Namespace) -> int:
    """The same answer as one page."""
    from rvjax import progress, study
    from rvjax.commands import forecast, module
    from rvjax.files import check_writable, write_atomically
    from rvjax.report import folders, page, text
    from rvjax.report.surrogate import surrogate
    from rvjax.study.answer import answer

    check_files(options, output=".html")
    asked = study.load(options.study, solve=False)
    if asked.costly:
        share_cores(1)
    given = options.output is not None
    path = Path(options.output) if given else folders.results_folder(None, asked.name) / "report.html"
    check_writable(path)
    forewarn(asked)
    sliders, writing = "numbers behind the sliders", "the page"
    with progress.shown(forecast.phases_of(asked, READING, sliders, writing), quiet=options.quiet):
        progress.begin(READING)
        found = answer(asked, progress=not options.quiet)
        progress.begin(sliders)
        moved = surrogate(found)
        budget = module("budget", "compute").budget_if_any(asked, found.allocation.tolerances)
        owners = None if budget is None else module("budget", "report").section_on(budget)
        progress.begin(writing)
        content = page.page(found, options.study, moved, owners, date=time.strftime("%Y-%m-%d")).encode("utf-8")
    if not given:
        path = folders.new_folder(path.parent) / path.name
    write_atomically(path, content)
    tell(
        options,
        lambda: f"{text.headline(found)}\nReport: {path}",
        lambda: text.as_json(found) | {"report": str(path)},
    )
    return EXIT_OK if found.allocation.status == "OPTIMAL" else EXIT_NO_ANSWER


def reproduce(options: argparse.Namespace) -> int:
    """Published figures beside computed ones."""
    from rvjax import published
    from rvjax.report import text

    rows = published.reproduce(say=lambda text: print(text, file=sys.stderr, flush=True))
    tell(options, lambda: text.comparison_table(rows, notes=options.notes), lambda: [row.as_json() for row in rows])
    return EXIT_OK


def tradeoff(options: argparse.Namespace) -> int:
    """Speed against accuracy of every model, measured here."""
    from rvjax import levels, plotting

    check_files(options, json=".json", picture=".png")
    started = time.perf_counter()
    table = levels.measure(
        quick=not options.full,
        seed=options.seed,
        say=lambda name: print(f"measuring {name}", file=sys.stderr, flush=True),
    )
    after = f"\n\n{time.perf_counter() - started:.1f} s, compilation included"
    tell(options, lambda: levels.report(table) + after, table.as_json)
    if options.json:
        table.save(options.json)
    if options.picture:
        plotting.tradeoff(table).savefig(options.picture)
    return EXIT_OK
