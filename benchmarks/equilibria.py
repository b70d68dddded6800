"""Time of one equilibrium of the loaded reducer by what it is for: `rvjax/levels/equilibria.toml`.

`python -m benchmarks.equilibria` takes minutes and writes the file. CPU seconds of the programs that solve the units of
`rv-40e-whole`, the least of some rounds, over the units and the equilibria of each.
"""

import time
from importlib import resources
from pathlib import Path

from benchmarks.timing import settings

settings()

import numpy as np  # noqa: E402  (after the flags)

from rvjax import models, study  # noqa: E402
from rvjax.levels.measure import machine  # noqa: E402
from rvjax.outputs import Reading  # noqa: E402
from rvjax.population import Population, root_key  # noqa: E402
from rvjax.response import numbers_of, parts  # noqa: E402

UNITS, ROUNDS = 1024, 5
LAWS = ("hertz", "linear")
OUTPUTS = {"loaded_transmission_error": "", "bench_lost_motion": "", "life": "loaded_transmission_error"}
"""Outputs, one for each kind; with one before it in the same program, whose time is taken off."""


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


def asked(law, outputs):
    """The study `rv-40e-whole` with some of its outputs under a contact law."""
    text = study.load("rv-40e-whole", solve=False).text
    head = text[: text.index("# Accuracy and assembly")].replace(
        "[conditions]\n", f'[conditions]\npin_contact = "{law}"\n'
    )
    head = head.replace("angles = 64               # crank angles of the misfit\n", "")
    if "life" not in outputs:
        head = "".join(line for line in head.splitlines(True) if not line.startswith("life_samples"))
    else:
        head += text[text.index("[[duty]]") : text.index("[requirement.life]")]
    if outputs == ["bench_lost_motion"]:
        head = "".join(line for line in head.splitlines(True) if not line.startswith("samples ="))
    limits = {name: 'lower = "6000 h"' if name == "life" else 'upper = "1 arcmin"' for name in outputs}
    return head + "".join(f"[requirement.{name}]\n{limit}\n" for name, limit in limits.items())


def main():
    """Measure, print and keep."""
    found = {}
    for law in LAWS:
        for output, before in OUTPUTS.items():
            outputs = [name for name in (before, output) if name]
            spent, work = microseconds(asked(law, outputs), outputs)
            own = next(kind for kind in work if kind not in found or law not in found[kind])
            spent -= sum(found[kind][law] * count for kind, count in work.items() if kind != own)
            found.setdefault(own, {})[law] = round(spent / work[own], 2)
            print(law, own, found[own][law], flush=True)
    place = Path(str(resources.files("rvjax.levels") / "equilibria.toml"))
    design, about = study.load("rv-40e-whole", solve=False).design, machine()
    lines = [
        "# Microseconds of one core for one equilibrium of a unit, by what it is for and the contact law.",
        "# Measured by `python -m benchmarks.equilibria`, which writes this file.",
        f"pins = {design.cycloid.pin_count * design.cycloid.disc_count} # of all discs",
        *(f"\n[{kind}]\n" + "\n".join(f"{law} = {us}" for law, us in by_law.items()) for kind, by_law in found.items()),
        f'\n[measured_on]\nprocessor = "{about["processor"]}"\ncores = {about["cores"]}\njax = "{about["jax"]}"',
    ]
    place.write_text("\n".join(lines) + "\n", "utf-8")


if __name__ == "__main__":
    main()
