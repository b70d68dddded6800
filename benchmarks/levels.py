"""Levels of some models measured again into the table that comes with rvjax: the others keep their figures.

`python -m benchmarks.levels --only loaded_turn` takes minutes; `--list` names what there is.
"""

import argparse
import dataclasses
from importlib import resources
from pathlib import Path

from benchmarks.timing import settings

settings()

from rvjax import levels  # noqa: E402  (after the flags)
from rvjax.levels.measure import machine  # noqa: E402


def main():
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--only", action="append", default=[], help="name of what is measured; more than once for several"
    )
    parser.add_argument("--list", action="store_true", help="print the names")
    parser.add_argument("--calls", type=int, help="batches of each error size, instead of the usual number")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--table", type=Path, default=Path(str(resources.files("rvjax.levels") / "table.json")))
    options = parser.parse_args()
    for cases in levels.measured():
        if options.list:
            print(cases.name)
        if cases.name not in options.only:
            continue
        if options.calls:
            cases = dataclasses.replace(cases, calls=options.calls)
        made = levels.measure_model(cases, seed=options.seed)
        table = type(levels.stored()).load(options.table)
        own = {} if _known(machine()) == _known(table.machine) else machine()
        models = table.models | {cases.name: dataclasses.replace(made, machine=own)}
        table = dataclasses.replace(table, models=models)
        table.save(options.table)
        print(levels.advice(models[cases.name]), flush=True)


def _known(where):
    return {key: where.get(key) for key in ("processor", "jax")}


if __name__ == "__main__":
    main()
