"""Several fidelities of the models: what cheap levels spare of the dear ones.

The four-bar linkage under load with its exact closure, beside the first-order closure, fewer angles and a linearised
curve; and the whole reducer with Hertzian pins (`--loaded`, whose figures are kept for the docs), beside its own
derivatives, the linkage, and linear pins at fewer angles, each alone too. Every case is asked with several seeds;
widths stand beside those of plain Monte Carlo of as many dear units, figures beside `--reference` plain ones.
"""

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np

from benchmarks.timing import publish, settings

settings()

import jax.numpy as jnp  # noqa: E402  (after the flags)

from rvjax import four_bar  # noqa: E402
from rvjax import loaded as whole  # noqa: E402
from rvjax.study import load  # noqa: E402
from rvjax.study.response import Response  # noqa: E402
from rvjax.tolerances import Outcome, Requirement, linearised, monte_carlo, multi_fidelity  # noqa: E402
from rvjax.units import arcmin  # noqa: E402

KEPT = Path(__file__).with_name("multi_fidelity_loaded.json")


def with_conditions(study, output, **changed):
    """The response of one output, under conditions that are partly others."""
    return Response.of(study.design, (output,), dataclasses.replace(study.conditions, **changed))


def linkage():
    """Peak to peak of the linkage under load; limit at which some 1 % fail."""
    study, name = load("rv-40e"), "transmission_error"
    given = study.conditions

    def curve(errors):
        torque, angles = given.output_torque, 16
        found = four_bar.revolution(study.design, errors, output_torque=torque, angles=angles, cranks=given.cranks)
        return found.error

    cheap = {
        "first order, 16 angles": with_conditions(study, name, closure="first_order", angles=16),
        "exact, 8 angles": with_conditions(study, name, angles=8),
        "linearised curve": linearised(curve, study.tolerances, then=_peak),
    }
    return with_conditions(study, name, angles=256), cheap, study.tolerances, name, arcmin


def loaded(torque):
    """Peak to peak of the whole reducer over a crank turn; the limit at which some 1 % fail."""
    study, name = load("rv-40e-whole"), "loaded_transmission_error"
    given = dataclasses.replace(study.conditions, output_torque=torque)
    study = dataclasses.replace(study, conditions=given)

    def curve(errors):
        found = whole.revolution(study.design, errors, output_torque=torque, samples=given.samples)
        return Outcome(found.error, found.info.status)

    cheap = {
        "linearised curve": linearised(curve, study.tolerances, then=_peak),
        "four-bar": with_conditions(study, "transmission_error", angles=64),
        "linear pins, 6 angles": with_conditions(study, name, samples=6, pin_contact="linear"),
    }
    return with_conditions(study, name), cheap, study.tolerances, name, arcmin


def _peak(curve):
    return jnp.max(curve) - jnp.min(curve)


def figures_of(case, samples, cheap_samples, seeds, reference, alone=False):
    """Gains and widths of one case; with `alone`, also of each cheap response and of the first two."""
    dear, cheap, tolerances, name, unit = case
    block = -(-(samples - samples // 2) // 2)  # of `multi_fidelity`: one program for all
    pilot = monte_carlo(dear, tolerances, samples=reference, seed=2026, chunk=block, quantiles=(0.99,))
    limit = pilot.quantiles[0.99][name].value
    need = {name: Requirement(upper=limit)}
    truth = monte_carlo(dear, tolerances, samples=reference, seed=2026, chunk=block, requirements=need)
    asked = dict(samples=samples, requirements=need)
    plain = [monte_carlo(dear, tolerances, seed=seed, chunk=block, **asked) for seed in range(seeds)]
    found = {"limit": limit / unit, "dear units": samples, "cheap units": cheap_samples, "seeds": seeds}
    found |= {"reference units": reference, "reference failed": int(truth.failed)}
    sets = {"": cheap}
    if alone:
        labels = list(cheap)
        chosen = [[label] for label in labels] + [labels[:2]]
        sets |= {" + ".join(each) + ": ": {label: cheap[label] for label in each} for each in chosen}
    for prefix, levels in sets.items():
        runs = [
            multi_fidelity(dear, levels, tolerances, cheap_samples=cheap_samples, seed=seed, **asked)
            for seed in range(seeds)
        ]
        found |= {prefix + key: value for key, value in _of(runs, plain, truth, name, unit).items()}
    return found


def _of(runs, plain, truth, name, unit):
    """Figures of some seeds with one set of cheap responses."""
    found = {"status": "; ".join(sorted({run.status[name] for run in runs}))}
    for label in runs[0].correlations[name]:
        found[f"correlation, {label}"] = float(np.mean([run.correlations[name][label] for run in runs]))
    found["correlation, all"] = float(np.mean([run.correlation[name] for run in runs]))
    for key in ("mean", "sd", "yield_"):
        exact, figure = getattr(truth, key)[name], key.rstrip("_")
        scale = 1.0 if key == "yield_" else unit
        mine, other = ([getattr(run, key)[name] for run in each] for each in (runs, plain))
        width, plain_width = (np.median([item.upper - item.lower for item in each]) for each in (mine, other))
        errors = [np.hypot(item.error, exact.error) for item in mine]
        found |= {
            f"{figure}, reference": exact.value / scale,
            f"{figure}, width": width / scale,
            f"{figure}, plain width": plain_width / scale,
            f"{figure}, evaluations of plain for the same width": float((plain_width / width) ** 2),
            f"{figure}, largest difference, standard errors of both": float(
                max(abs(item.value - exact.value) / error for item, error in zip(mine, errors))
            ),
        }
    seconds = runs[-1].seconds
    found["cost of a dear unit, cheap ones together"] = seconds["dear"] / seconds["cheap"]
    found["cheap per dear unit, best"] = runs[-1].cheap_per_dear[name]
    return found


def main():
    """Print, publish, and keep the figures of the whole reducer."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--samples", type=int, default=400)
    parser.add_argument("--cheap-samples", type=int, default=40_000)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--reference", type=int, default=400_000, help="plain units behind the exact figures")
    parser.add_argument("--loaded", action="store_true", help="the whole reducer instead of the linkage")
    parser.add_argument("--torque", type=float, default=412.0, help="on the whole reducer, N m")
    options = parser.parse_args()
    sizes = options.samples, options.cheap_samples, options.seeds, options.reference
    figures = figures_of(loaded(options.torque) if options.loaded else linkage(), *sizes, alone=options.loaded)
    publish("multi_fidelity_models", figures, options.json)
    if options.loaded:
        kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
        KEPT.write_text(json.dumps(kept | {f"{options.torque:g}": figures}, indent=1) + "\n")


if __name__ == "__main__":
    main()
