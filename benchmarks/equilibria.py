"""Time of one equilibrium of the loaded reducer by what it is for: `rvjax/levels/equilibria.toml`.

`python -m benchmarks.equilibria` takes minutes and writes the file. CPU seconds of the programs that solve the units of
`rv-40e-whole` and `cycloidal-17`, the least of some rounds, over the units and the equilibria of each.
`--only cycloidal` measures one kind of reducer and keeps the others. Its times have the ratio to a turn of the RV
reducer in this run, so that all are those of one computer.
"""

import argparse
import re
import time
from importlib import resources
from pathlib import Path

from benchmarks.timing import settings

settings()

import numpy as np  # noqa: E402  (after the flags)

from rvjax import models, study  # noqa: E402
from rvjax.levels.choice import contacts, equilibrium_times  # noqa: E402
from rvjax.levels.measure import machine  # noqa: E402
from rvjax.outputs import Reading  # noqa: E402
from rvjax.population import Population, root_key  # noqa: E402
from rvjax.response import numbers_of, parts  # noqa: E402

UNITS, ROUNDS = 4096, 5  # units: as many as a call of a response that is not costly computes
LAWS = ("hertz", "linear")
STUDIES = {"rv": "rv-40e-whole", "cycloidal": "cycloidal-17"}
OUTPUTS = {
    "rv": {"loaded_transmission_error": "", "bench_lost_motion": "", "life": "loaded_transmission_error"},
    "cycloidal": dict.fromkeys(("turn_pin_pressure", "backlash", "bench_lost_motion", "fit_clearance"), ""),
}
"""Outputs, one for each use; with one before it in the same program, whose time is taken off."""
LIMITS = {"life": 'lower = "6000 h"', "turn_pin_pressure": 'upper = "3 GPa"', "fit_clearance": 'lower = "0 um"'}


def microseconds(text, outputs):
    """CPU time of a unit, and {kind: number} of its equilibria."""
    question = study.parse_study(text, name="equilibria", solve=False)
    kind, population = models.kind(question.design), Population.of(question.tolerances)
    work = {}
    for name in outputs:
        evaluate = kind.outputs[name].evaluate
        assert isinstance(evaluate, Reading)
        work |= dict(kind.work[source](question.conditions) for source in evaluate.sources)
    (part,) = parts(question.response(solve=False), population)
    z = numbers_of(population, root_key(0), np.arange(UNITS))
    part.solve(population, z)
    best = np.inf
    for _ in range(ROUNDS):
        start = time.process_time()
        part.solve(population, z)
        best = min(best, time.process_time() - start)
    return 1e6 * best / UNITS, work


def asked(name, law, outputs):
    """The embedded study of a kind of reducer with some of its outputs under a contact law."""
    own = study.load(STUDIES[name], solve=False)
    tables = re.split(r"(?m)^(?=\[)", own.text)
    read = models.kind(own.design).conditions_of(tuple(outputs))
    kept = []
    for table in tables:
        head = table.partition("]")[0].lstrip("[").partition(".")[0]
        if head == "conditions":
            lines = table.splitlines(True)[1:]
            given = (line for line in lines if line.partition(" =")[0] in read and _needed(line, outputs))
            kept.append("".join(["[conditions]\n", f'pin_contact = "{law}"\n', *given]))
        elif head in ("design", "tolerances") or (head == "duty" and "life" in outputs):
            kept.append(table)
    limits = {output: LIMITS.get(output, 'upper = "1 arcmin"') for output in outputs}
    return "".join(kept) + "".join(f"[requirement.{output}]\n{limit}\n" for output, limit in limits.items())


def _needed(line, outputs):
    """Conditions that an output does not read are an error in a study."""
    key = line.partition(" =")[0]
    return "life" in outputs or not key.startswith("life")


def main():
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=list(OUTPUTS), help="this kind of reducer alone; the others are kept")
    only, found, about, scale = parser.parse_args().only, {}, machine(), 1.0
    if only is not None:
        outputs = list(OUTPUTS["rv"])[:1]
        spent, work = microseconds(asked("rv", "hertz", outputs), outputs)
        scale = equilibrium_times()["rv"]["turn"]["hertz"] * work["turn"] / spent
        about = equilibrium_times()["measured_on"]
        print("scale", scale, flush=True)
    for name, outputs_of in OUTPUTS.items():
        if only not in (None, name):
            found[name] = equilibrium_times()[name]
            continue
        design = study.load(STUDIES[name], solve=False).design
        found[name] = own = {"contacts": contacts(design)}
        for law in LAWS if name == "rv" or design.contact.pin_stiffness is not None else LAWS[:1]:
            for output, before in outputs_of.items():
                outputs = [each for each in (before, output) if each]
                spent, work = microseconds(asked(name, law, outputs), outputs)
                use = next(each for each in work if each not in own or law not in own[each])
                spent -= sum(own[each][law] / scale * count for each, count in work.items() if each != use)
                own.setdefault(use, {})[law] = round(scale * spent / work[use], 2)
                print(name, law, use, own[use][law], flush=True)
    lines = [
        "# Microseconds of one core for one equilibrium of a unit, by kind of reducer, use and contact law.",
        "# turn: at rated torque; probe, bench: +-0.1 and +-3 % of it; life: spread over a revolution; fit: no load.",
        "# Measured by `python -m benchmarks.equilibria`, which writes this file.",
    ]
    for name, own in found.items():
        lines += [f"\n[{name}]", f"contacts = {own['contacts']} # pins and output pins, of all discs"]
        for use, by_law in own.items():
            if use != "contacts":
                lines += [f"\n[{name}.{use}]", *(f"{law} = {us}" for law, us in by_law.items())]
    lines += [f'\n[measured_on]\nprocessor = "{about["processor"]}"\ncores = {about["cores"]}\njax = "{about["jax"]}"']
    place = Path(str(resources.files("rvjax.levels") / "equilibria.toml"))
    place.write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main()
