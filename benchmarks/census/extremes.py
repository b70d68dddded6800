"""Census of the extremes: random inputs over the domain of every model and beyond it, each checked.

    python -m benchmarks.census.extremes --inputs 1e6          one million inputs for each group of models
    python -m benchmarks.census.extremes --budget 5            what fits into five minutes
    python -m benchmarks.census.extremes --model mesh_force    groups or models whose name begins so
    python -m benchmarks.census.extremes --page                only write the tables of docs/stability.md, NOTES.md

Result on screen and in census.json, per model: how many inputs ended with which status; silent NaN or infinity, and
finite values where NaN is due; statuses and values against an independent computation; the largest residual;
derivatives against differences; single against double precision. An interrupted census goes on where it was, model
by model; `--fresh` starts again. The worst inputs are kept so that they can be run again.
"""

import argparse
import datetime
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import tqdm

from benchmarks.census.table import CENSUS, PAGE, stored, write_pages
from benchmarks.timing import settings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=float, default=1e6, help="per group of models")
    parser.add_argument("--budget", type=float, help="minutes for all")
    parser.add_argument("--model", nargs="*", help="names that begin so; all by default")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, default=CENSUS)
    parser.add_argument("--fresh", action="store_true", help="forget what the file holds")
    parser.add_argument("--page", action="store_true", help="only write the tables of the pages from the file")
    options = parser.parse_args()
    if not options.page:
        take_census(options)
    if options.json == CENSUS and PAGE.exists():
        write_pages(stored())


def take_census(options: argparse.Namespace) -> None:
    """Run what the file does not hold yet; write it after every model."""
    settings()
    np.seterr(all="ignore")
    from benchmarks.census.models import models
    from benchmarks.census.one_model import census, show

    everything = list(models())
    shared = {m.group: sum(other.group == m.group for other in everything) for m in everything}
    wanted = [m for m in everything if not options.model or m.name.startswith(tuple(options.model))]
    asked = {m.name: max(1, round(options.inputs / shared[m.group])) for m in wanted}
    file: dict[str, Any] = {"seed": options.seed, "census": []}
    if options.json.exists() and not options.fresh:
        file = json.loads(options.json.read_text())
    done = {e["model"] for e in file["census"] if e["asked"] == asked.get(e["model"]) and file["seed"] == options.seed}
    todo = [m for m in wanted if m.name not in done]
    clock, bar = time.perf_counter(), tqdm.tqdm(total=sum(asked[m.name] for m in todo), unit="input", smoothing=0.05)
    for number, model in enumerate(todo):
        share = np.inf
        if options.budget:
            left = 60 * options.budget - (time.perf_counter() - clock)
            share = time.perf_counter() + max(0.0, left) / (len(todo) - number)
        bar.set_description(model.name)
        entry = {**census(model, asked[model.name], options.seed, share, bar.update), "asked": asked[model.name]}
        kept = [e for e in file["census"] if e["model"] != model.name] if file["seed"] == options.seed else []
        order = [m.name for m in everything]
        kept = sorted([*kept, entry], key=lambda e: order.index(e["model"]))
        file = {"seed": options.seed, "day": datetime.date.today().isoformat(), "census": kept}
        temporary = options.json.with_suffix(".part")
        temporary.write_text(written(file))
        temporary.replace(options.json)
        with bar.external_write_mode():
            show(entry)
    bar.close()


def written(file: dict[str, Any]) -> str:
    """As JSON, a model a line."""
    head = json.dumps({name: value for name, value in file.items() if name != "census"})
    return head[:-1] + ', "census": [\n' + ",\n".join(map(json.dumps, file["census"])) + "\n]}\n"


if __name__ == "__main__":
    main()
