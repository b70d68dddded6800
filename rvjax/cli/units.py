"""The commands about units: measured; one function a command."""

import argparse

from rvjax.commands import EXIT_NO_ANSWER, EXIT_OK, READING, WRITING, tell


def identify(options: argparse.Namespace) -> int:
    """What made this measured curve."""
    from rvjax import progress, study
    from rvjax.report import folders, identified_page
    from rvjax.report import identified as told
    from rvjax.study import identified, measured, problem

    coming = (identified.SEEING, identified.RANKING) if options.check else (*identified.PHASES, WRITING)
    with progress.shown(dict.fromkeys((READING, *coming), 0.0), quiet=options.quiet):
        progress.begin(READING)
        question = study.load(options.study, solve=False)
        asked = problem.asked_of(question)
        data = measured.read(options.data, asked.columns) if options.data else None
        if options.check:
            found = identified.check(question, data)
        elif data is None:
            raise ValueError("no data: name at least one CSV file, or ask with --check what a bench could tell apart")
        else:
            folder = folders.results_folder(options.results, question.name)
            found = identified.answer(question, data, draws=options.sample)
            progress.begin(WRITING)
            pictures = ((f"{picture.name}.png", picture.content) for picture in identified_page.pictures(found))
            page = ("report.html", identified_page.page(found, options.study, options.data).encode())
            folder = folders.write_files(told.files(found, options.data, (page, *pictures)), folder)
    after = "" if options.check else f"\n\nResults: {folder}"
    tell(options, lambda: told.summary(found) + after, lambda: told.as_json(found))
    return EXIT_NO_ANSWER if found.adequate is False else EXIT_OK
