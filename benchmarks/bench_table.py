"""Errors of an RV-40E that a bench can distinguish: orders of the output turn at one, two and three torques, noise
1 arcsec. `python -m benchmarks.bench_table` recomputes the table, `--keep` stores it for docs/identify_bench.md.

The loaded model is linearised at units sampled from the tolerances. The information of a bench on a field, in numbers:
the sum over its elements of 1 - (posterior sd / prior sd)^2, which over all fields is the sum of lambda / (1 + lambda).
"""

import argparse
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

import rvjax
from rvjax import catalogue, identify, models
from rvjax.loaded.cases import MACHINE
from rvjax.measured import Conditions
from rvjax.study.bench import curve_model
from rvjax.study.identification import nuisance
from rvjax.tolerances import Tolerance, for_design, sample
from rvjax.units import arcmin, arcsec, um

KEPT = Path(__file__).with_suffix(".json")
RATED = 412.0
# Springs and width of the discs are assumed, as in docs/models/loaded_machine.md.
DESIGN = catalogue.RV_40E.replace(stiffness=MACHINE.stiffness, contact=MACHINE.contact)
PLACES = dict(pin_offset=5 * um, pin_radii=1 * um, disc_pitch=5 * um, disc_centre=7.5 * um, ring_centre=10 * um)
PLACES |= dict(disc_profile=2 * um, sun_runout=10 * um, planet_runout=10 * um)
BENCHES = {
    "rated torque": (0,),
    "and 30 %": (0, 1),
    "and 10 %": (0, 1, 2),
    "all three, both ways": (0, 1, 2, 3, 4, 5),
}
"""Runs of each bench: places in `runs`."""
UNSEEN = 1e6  # rad: noise of a run that a bench does not make


def runs() -> list[Conditions]:
    """Every run that some bench makes."""
    shares = (1.0, 0.3, 0.1)
    return [Conditions(torque=s * RATED, direction=d) for d in ("forward", "backward") for s in shares]


def prior() -> dict[str, Tolerance]:
    """Limits of the parts: those of the study rv-40e for links and play, and for what has a place the usual ones."""
    link = Tolerance.symmetric(6.5 * um)
    made = for_design(
        DESIGN,
        crank_eccentricity=link,
        disc_bore=link,
        carrier_bore=link,
        crank_phase=Tolerance.symmetric(5 * arcmin),
        bearing_clearance=Tolerance(4 * um, 12 * um),
        pin_circle_radius=Tolerance.symmetric(5 * um),
        pin_radius=Tolerance.symmetric(2 * um),
        base_tangent_upper=Tolerance(-31 * um, 3 * um),
        **{name: Tolerance.symmetric(size) for name, size in PLACES.items()},
    )
    fields = {name: getattr(made, name) for name in vars(made) if isinstance(getattr(made, name), Tolerance)}
    return fields | {"offset": nuisance("offset", (1,))}


def known(finest: int, units: int, seed: int = 0) -> dict[str, Any]:
    """Information of each bench on each field.

    Args:
        finest: highest order of the output turn that is measured.
        units: sampled units, whose mean is returned.
        seed: of them.
    """
    fields, orders = prior(), tuple(range(1, finest + 1))
    conditions = models.kind(DESIGN).conditions(rated_torque=RATED)
    model = curve_model("loaded", DESIGN, conditions, runs(), orders, ("offset",), tuple(fields))
    drawn = jax.jit(jax.vmap(lambda index: sample(fields, index, seed=seed)))(np.arange(units, dtype=np.uint32))
    shape = jax.eval_shape(model, jax.tree.map(lambda x: x[0], drawn))
    found: dict[str, Any] = {bench: [] for bench in BENCHES}
    for unit in range(units):
        at = jax.tree.map(lambda x, unit=unit: x[unit], drawn)
        for bench, made in BENCHES.items():
            sd = np.where(np.isin(np.arange(len(runs())), made), 1 * arcsec, UNSEEN)
            noise = identify.Noise(dict.fromkeys(shape, sd))
            seen = identify.identifiability(model, fields, noise=noise, at=at, nuisance=("offset",))
            of_field = {name: 0.0 for name in fields if name != "offset"}
            for name, left in zip(seen.names, seen.u_sd):
                if name.partition("[")[0] != "offset":
                    of_field[name.partition("[")[0]] += 1 - float(left) ** 2
            own = [n for n in seen.names if n != "offset"]
            counts = {v: sum(seen.verdict[n] == v for n in own) for v in ("identified", "combination", "unseen")}
            found[bench].append(dict(known=of_field, directions=len(seen.directions) - 1, **counts))
    numbers = {name: int(np.prod(t.shape)) for name, t in fields.items() if name != "offset"}
    mean = lambda rows, key: float(np.mean([row[key] for row in rows]))  # noqa: E731
    return {
        "numbers": numbers,
        "benches": {
            bench: {
                "known": {name: float(np.mean([row["known"][name] for row in rows])) for name in numbers},
                **{key: mean(rows, key) for key in ("directions", "identified", "combination", "unseen")},
            }
            for bench, rows in found.items()
        },
        "finest": finest,
        "units": units,
        "seed": seed,
        "noise": "1 arcsec",
    }


def table(found: dict[str, Any]) -> list[list[str]]:
    """Headers and rows: numbers of a field that each bench identifies.

    Args:
        found: as kept.
    """
    rows = [["error", "numbers", *found["benches"]]]
    for name, count in found["numbers"].items():
        rows.append([name, str(count), *(f"{b['known'][name]:.1f}" for b in found["benches"].values())])
    total = [f"{sum(b['known'].values()):.1f}" for b in found["benches"].values()]
    rows.append(["all", str(sum(found["numbers"].values())), *total])
    for key, text in (("directions", "directions seen"), ("identified", "elements identified alone")):
        rows.append([text, "", *(f"{b[key]:.1f}" for b in found["benches"].values())])
    return rows


def main() -> None:
    """Print the table, and store it with --keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--keep", action="store_true", help=f"write {KEPT.name}")
    parser.add_argument("--finest", type=int, default=100)
    parser.add_argument("--units", type=int, default=4)
    options = parser.parse_args()
    rvjax.enable_x64()
    found = known(options.finest, options.units)
    for row in table(found):
        print("  ".join(cell.ljust(26) if k == 0 else cell.rjust(12) for k, cell in enumerate(row)))
    if options.keep:
        KEPT.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()
