"""An identification in words: combinations of errors, verdicts, what to measure next."""

import math
from collections.abc import Mapping

import numpy as np

from rvjax._ground.columns import element, place_of
from rvjax.commands.identify.compute import Identified
from rvjax.commands.identify.head import CONSISTENT, Head
from rvjax.records import PyTree
from rvjax.units import arcsec, deg

SHOWN = 0.3  # loadings below this share of the largest are not part of a combination in words
EQUAL = 0.1  # loadings that differ less count as one


def field_of(name: str) -> str:
    """Field of an element: "crank_phase[1]" -> "crank_phase"."""
    return place_of(name)[0]


def in_words(loadings: Mapping[str, float]) -> str:
    """A combination as a person writes it: "crank eccentricity [0,0] - [0,1] - [1,0] + [1,1]"."""
    largest = max(map(abs, loadings.values()))
    terms = {name: size for name, size in loadings.items() if abs(size) >= SHOWN * largest}
    alike = all(abs(abs(size) - largest) <= EQUAL * largest for size in terms.values())
    lead = 1.0 if next(iter(terms.values())) > 0 else -1.0
    said, field = "", ""
    for name, size in terms.items():
        own = field_of(name)
        place = name[len(own) :]
        factor = "" if alike else f"{abs(size) / largest:.2g} "
        shown = place if own == field and place else " ".join([own.replace("_", " "), place]).strip()
        sign = "-" if lead * size < 0 else "+"
        said += f" {sign} {factor}{shown}" if said else f"{factor}{shown}"
        field = own
    return said


def elements(structure: Mapping[str, PyTree]) -> dict[str, float]:
    """{element: number} of values with the structure of a prior."""
    found = {}
    for name in sorted(structure):
        values = np.asarray(structure[name], float)
        for place in np.ndindex(values.shape):
            found[element(name, place)] = float(values[place])
    return found


def direction_lines(answer: Identified) -> list[str]:
    """Describe what the data identify, strongest first."""
    lines = []
    for direction in answer.check.directions:
        left = 1 / math.sqrt(1 + direction.information)
        lines.append(f"{in_words(direction.loadings)}: to {100 * left:.3g} % of the range of the drawing")
    return lines


def verdict_line(answer: Identified) -> str:
    """Count the elements and the combinations that the data identify."""
    own = [name for name in answer.check.names if field_of(name) not in answer.problem.nuisance]
    counts = {
        kind: sum(answer.check.verdict[n] == kind for n in own) for kind in ("identified", "combination", "unseen")
    }
    many = f"{len(own)} elements: {counts['identified']} identified"
    return f"{many}, {counts['combination']} in combinations only, {counts['unseen']} unseen"


def headline(answer: Identified) -> str:
    """The verdict on the data in a line or two."""
    name = answer.study.name
    if answer.posterior is None and answer.batch is None:
        return f"Study {name}: what {_what(answer)} can identify"
    if answer.batch is not None:
        wrong = sum(status != "CONVERGED" for status in answer.batch.status)
        return f"Study {name}: {len(answer.problem.units)} units, {wrong} with another status than CONVERGED"
    found = answer.posterior
    assert found is not None
    lines = [f"Study {name}: {found.status}"]
    if not found.modes:
        return f"{lines[0]}\nThe solver found no mode; the data may still fit. Other orders or a larger noise may help."
    p, prior = found.fit.p_model, found.fit.p_prior
    cannot = "The model cannot explain the data: another reducer, a missing effect, or noise understated"
    lines.append(f"{'The model can explain the data' if found.adequate else cannot} (p = {p:.3g}).")
    if prior < 1e-3:
        lines.append(
            f"Parts of this drawing rarely give such a curve (p = {prior:.3g}): something is out of tolerance."
        )
    return "\n".join(lines)


def _what(answer: Identified) -> str:
    if answer.problem.kind != "curve":
        return "a loop" if answer.problem.kind == "loop" else "frequencies"
    runs = [run.text() for run in answer.problem.runs]
    return f"{len(runs)} run{'s' if len(runs) > 1 else ''} ({'; '.join(runs)})"


def next_lines(answer: Identified) -> list[str]:
    """List the three best next measurements, best first."""
    return [f"{name}: {gain:.3g} nats" for name, gain in list((answer.gains or {}).items())[:3]]


def head_lines(head: Head) -> list[str]:
    """The encoder head that the data describe: direction, amplitudes, and whether one head explains them."""
    value, lower, upper = (x / deg for x in head.angle)
    several = "its direction is not determined"
    placed = several if math.isnan(value) else f"at {value:.1f} deg from pin 0 [{lower:.1f} .. {upper:.1f}]"
    sizes = [
        f"{n} {g / arcsec:.3g} arcsec [{a / arcsec:.3g} .. {b / arcsec:.3g}]"
        for n, (g, a, b) in head.amplitudes.items()
    ]
    lines = [f"Head: {placed}; at the rated torque {', '.join(sizes)}."]
    if not math.isnan(value):
        lines.append("Assumed: the scale is on the side of the last disc. On the other side add 180 deg.")
    if not math.isnan(head.p):
        fits = f"One head explains these numbers (p = {head.p:.3g})."
        lines.append(fits if head.p >= CONSISTENT else f"No single head explains these numbers (p = {head.p:.3g}).")
    return lines


def shares_text(fields: Mapping[str, float]) -> str:
    """Shares of at least half a percent, the largest first."""
    seen = sorted((f for f in fields if abs(fields[f]) >= 0.005), key=lambda f: -abs(fields[f]))
    return ", ".join(f"{name.replace('_', ' ')} {100 * fields[name]:.0f} %" for name in seen) or "-"
