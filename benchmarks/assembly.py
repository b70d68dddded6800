"""Matching parts of an RV-40E: what it gains, whether it comes true, and how long it takes.

    python -m benchmarks.assembly                 everything
    python -m benchmarks.assembly --only gauge    one of gauge, levers, times

gauge: 24 crankshafts in pairs, 30 measured sets for every measurement uncertainty: what plans promise, and what comes
true with the true errors of the same parts; and the promise of plans that take the measured values for true.
levers: the loaded reducer with assumed tolerances, exact measurements: good units of random assembly, of discs turned
over as they come, of discs turned over and paired, and with classes of bearings besides. The limit is the mean of
random assembly of the first set. times: 200 x 200 discs in 4 positions, compilation included; they mean nothing on a
busy computer. Figures are kept in `benchmarks/assembly.json`.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from benchmarks.timing import machine, settings

settings()

import jax.numpy as jnp  # noqa: E402  (after the flags)

from rvjax import assembly, catalogue, four_bar, loaded  # noqa: E402
from rvjax.assembly import Kind, Part  # noqa: E402
from rvjax.loaded.cases import MACHINE  # noqa: E402
from rvjax.mounting import disc_mountings, unit_errors  # noqa: E402
from rvjax.tolerances import Outcome, Requirement, Tolerance  # noqa: E402
from rvjax.units import arcsec, um  # noqa: E402

KEPT = Path(__file__).with_name("assembly.json")
RATED = 412.0
# Assumed: no maker publishes stiffnesses, face width or tolerances.
DESIGN = catalogue.RV_40E.replace(
    stiffness=MACHINE.stiffness.replace(output_support=2e9),
    contact=MACHINE.contact,
)
CENTRE, PITCH, PROFILE, BORE = 3 * um, 1 * um, 0.5 * um, 2 * um  # standard deviations of one disc
CLASSES = np.array([2, 4, 6, 8]) * um  # of bearing clearance
SETS, SAMPLES = 30, 8  # samples: input angles over one crank turn of the loaded reducer


def unloaded(parts, index):
    """Transmission error of the second stage, peak to peak over a crank turn of 16 angles."""
    found = four_bar.figures(
        catalogue.RV_40E, unit_errors(catalogue.RV_40E, parts, index), angles=16, output_torque=RATED
    )
    return Outcome(found.peak_to_peak, found.info.status)


def seated(parts, index):
    """Largest misfit of a disc on its cranks over a crank turn of 16 angles: what bores do in the four-bar model."""
    found = four_bar.figures(catalogue.RV_40E, unit_errors(catalogue.RV_40E, parts, index), angles=16)
    return Outcome(found.largest_misfit, found.info.status)


def whole(parts, index):
    """Transmission error of the loaded reducer under rated torque, peak to peak over a crank turn."""
    found = loaded.revolution(DESIGN, unit_errors(DESIGN, parts, index), output_torque=RATED, samples=SAMPLES)
    return Outcome(found.peak_to_peak, found.info.status)


def discs(rng, count, **options):
    """Discs with errors of bores and teeth."""
    sizes = {"disc_bore": (BORE, (2, 2)), "disc_centre": (CENTRE, (2,)), "disc_pitch": (PITCH, (39,))}
    sizes["disc_profile"] = (PROFILE, (5, 2))
    parts = [
        Part(k, {name: sd * rng.standard_normal(shape) for name, (sd, shape) in sizes.items()}) for k in range(count)
    ]
    return Kind(parts, indices=len(disc_mountings(DESIGN, 0)), **options)


def gauge():
    """Mean peak to peak as a share of random assembly, by measurement uncertainty in spreads of the parts."""
    spread, count = 2.17 * um, 24
    population = {"crank_eccentricity": Tolerance.symmetric(3 * spread)}
    found = {"sd": [], "promised": [], "came true": [], "unshrunk promise": [], "error of the difference": []}

    def kinds(errors, noise, sd, known):
        parts = [
            Part(k, {"crank_eccentricity": e + n}, sd if known else 0.0) for k, (e, n) in enumerate(zip(errors, noise))
        ]
        stock = Kind(parts, population=population if known else None)
        return {"crank_0": stock, "crank_1": stock}

    chance = []
    for share in (0.0, 0.25, 0.5, 1.0, 2.0):
        promised, true, naive = [], [], []
        for number in range(SETS):
            rng = np.random.default_rng([number, round(100 * share)])
            errors, noise = spread * rng.standard_normal((2, count, 2))
            measured = kinds(errors, share * noise, share * spread, True)
            plan = assembly.plan(unloaded, measured, draws=32, certificate_draws=128)
            exact = {k: {"crank_eccentricity": e} for k, e in enumerate(errors)}
            units = [{slot: exact[k] for slot, k in unit.items()} for unit in plan.build]
            stacked = {slot: {"crank_eccentricity": np.stack([u[slot]["crank_eccentricity"] for u in units])}
                       for slot in ("crank_0", "crank_1")}  # fmt: skip
            true.append(float(jnp.mean(TRUE(stacked))))
            promised.append(plan.objective)
            naive.append(assembly.plan(unloaded, kinds(errors, share * noise, 0.0, False)).objective)
            if share == 0:
                chance.append(plan.random.value)
        found["sd"].append(share)
        for name, values in (("promised", promised), ("came true", true), ("unshrunk promise", naive)):
            found[name].append(float(np.mean(values) / np.mean(chance)))
        off = np.subtract(true, promised) / np.mean(chance)
        found["error of the difference"].append(float(off.std(ddof=1) / np.sqrt(SETS)))
    return found | {"random, arcsec": float(np.mean(chance) / arcsec)}


def _true():
    import jax

    index = {"crank_0": 0, "crank_1": 0}
    return jax.jit(jax.vmap(lambda parts: unloaded(parts, index).value))


TRUE = _true()


def levers(count=10, sets=8):
    """Good units and mean peak to peak of the loaded reducer, by what is allowed to be chosen."""
    names = ("random", "turned over", "turned over and paired", "with classes of bearings")
    good, mean, limit = {n: [] for n in names}, {n: [] for n in names}, None
    for number in range(sets):
        rng = np.random.default_rng(100 + number)
        first, second = discs(rng, count), discs(rng, count)
        bearings = Kind([Part(f"{c / um:g} um", {"bearing_clearance": c}) for c in CLASSES], stock=[3, 3, 3, 3])
        given = {"disc_0": first, "disc_1": second, "bearings": bearings}
        as_they_come = rng.permutation(np.repeat(np.arange(len(CLASSES)), 3))[:count]
        if limit is None:
            middle = assembly.plan(whole, given)
            limit = Requirement(upper=middle.random.value)
        options = dict(objective="yield", requirement=limit)
        best = assembly.plan(whole, given, **options)
        alone = []
        for k in range(count):
            single = {s: Kind([kind.parts[as_they_come[k] if s == "bearings" else k]], indices=kind.indices)
                      for s, kind in given.items()}  # fmt: skip
            alone.append(assembly.plan(whole, single, **options))
        same = Kind([bearings.parts[1]], stock=[count])
        paired = assembly.plan(whole, given | {"bearings": same}, **options)
        rows = {
            "random": (best.random_yield.value, best.random.value),
            "turned over": (np.mean([p.objective for p in alone]), np.mean([p.values[0] for p in alone])),
            "turned over and paired": (paired.objective, paired.values.mean()),
            "with classes of bearings": (best.objective, best.values.mean()),
        }
        for name, (share, value) in rows.items():
            good[name].append(share)
            mean[name].append(value)
    return {
        "limit, arcsec": limit.upper / arcsec,
        "good units": {name: float(np.mean(values)) for name, values in good.items()},
        "standard error": {name: float(np.std(values, ddof=1) / np.sqrt(sets)) for name, values in good.items()},
        "mean, arcsec": {name: float(np.mean(values) / arcsec) for name, values in mean.items()},
    }


def times(count):
    """Seconds of a plan of count x count discs in 4 positions, compilation included."""
    found = {"parts": count, "angles of the loaded reducer": SAMPLES}
    for name, response in (("four_bar", seated), ("loaded", whole)):
        rng = np.random.default_rng(0)
        given = {"disc_0": discs(rng, count), "disc_1": discs(rng, count)}
        if name == "four_bar":
            bores = [{"disc_bore": part.errors["disc_bore"]} for kind in given.values() for part in kind.parts]
            halves = (bores[:count], bores[count:])
            given = {s: Kind([Part(k, e) for k, e in enumerate(own)], indices=2) for s, own in zip(given, halves)}
        started = time.perf_counter()
        plan = assembly.plan(response, given)
        found[f"{name}, s"] = round(time.perf_counter() - started, 2)
        started = time.perf_counter()
        assembly.plan(response, given)
        found[f"{name} again, s"] = round(time.perf_counter() - started, 2)
        found[f"{name}: left of random"] = float(plan.objective / plan.random.value)
    return found


def main() -> None:
    """Run the selected parts and store their values."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=["gauge", "levers", "times"])
    parser.add_argument("--parts", type=int, default=200, help="discs of each slot whose plan is timed")
    options = parser.parse_args()
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    for name, run in (("gauge", gauge), ("levers", levers), ("times", lambda: times(options.parts))):
        if options.only in (None, name):
            kept[name] = run()
            print(name, json.dumps(kept[name], indent=1))
    kept["machine"] = machine()
    KEPT.write_text(json.dumps(kept, indent=1) + "\n")


if __name__ == "__main__":
    main()
