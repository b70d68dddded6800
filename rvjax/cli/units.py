"""The commands about units: drawn, measured, assembled; one function a command."""

import argparse
import contextlib
import os
import time

from rvjax.commands import EXIT_NO_ANSWER, EXIT_OK, READING, WRITING, check_files, forewarn, tell

# A loop over blocks of units has one thread, so each core becomes a device of JAX, which takes its part of every chunk;
# more devices would leave each too few blocks.
_MOST_DEVICES = 8


def montecarlo(options: argparse.Namespace) -> int:
    """What a batch of units does."""
    from rvjax import progress
    from rvjax.report import batch as written
    from rvjax.study import batch
    from rvjax.tolerances import ENDINGS, UnitFile

    check_files(options, json=".json", save=(".npz", *ENDINGS))
    table = options.save if options.save and options.save.endswith(ENDINGS) else None
    if options.save_errors and table is None:
        raise ValueError(f"--save-errors: needs --save FILE with {' or '.join(ENDINGS)}, not {options.save}")
    if table is not None:
        UnitFile(table)  # says before any work that an extra is missing
    _share_cores(int(options.worker[2]) if options.worker else 1)

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
    with progress.shown(expected, counted=drawing, quiet=options.quiet or options.processes > 1):
        progress.begin(READING)
        wanted = asked()
        question = wanted.study  # as it was read before the run: the file may change meanwhile
        forewarn(question)
        progress.begin(drawing)
        if options.processes == 1:
            found = batch.run(wanted)
        else:
            found = batch.run_in_processes(
                options.command, options.processes, text=question.text, table=table, chunk=wanted.chunk
            )
    seconds = time.perf_counter() - started
    written.write(found, question, options.study, figures=options.json, samples=options.save if wanted.keep else None)
    after = f"\n\n{seconds:.1f} s, start and compilation included"
    tell(options, lambda: written.summary(found, question) + after, lambda: written.as_json(found, question))
    return EXIT_OK


def _share_cores(processes: int) -> None:
    """A device of JAX for each core, among `processes`; JAX_NUM_CPU_DEVICES says otherwise."""
    if "JAX_NUM_CPU_DEVICES" in os.environ or "host_platform_device_count" in os.environ.get("XLA_FLAGS", ""):
        return
    import jax

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    with contextlib.suppress(RuntimeError):  # whoever called `main` uses JAX already
        jax.config.update("jax_num_cpu_devices", max(1, min(cores // processes, _MOST_DEVICES)))


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
