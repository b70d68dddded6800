"""An identification in words: combinations of errors, verdicts, what to measure next."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rvjax import identify
from rvjax.base.fields import element, place_of
from rvjax.commands.identify.head import CONSISTENT, Head
from rvjax.commands.identify.identified import Identified
from rvjax.records import PyTree
from rvjax.render import Quantity
from rvjax.study import NUISANCES, field_unit
from rvjax.units import KNOWN, arcsec, deg, readable

SHOWN = 0.3  # loadings below this share of the largest are not part of a combination in words
EQUAL = 0.1  # factors that differ less count as one
MOST_TERMS = 8  # elements that a combination in words names
MOST_LEFT = 3  # fields of the rest that it names


@dataclass(frozen=True)
class Combination:
    """Elements that the data determine together.

    Attributes:
        terms: {element: factor} of those that its words name, the largest factor 1; empty where they are many.
        rest: {field: share of the square of the combination} of others that move it more than it is known to.
        known: standard deviation after the measurement, in that of the drawing.
        value: of the sum of the terms; None without data, without terms or for terms of several units.
    """

    terms: dict[str, float]
    rest: dict[str, float]
    known: float
    value: Quantity | None

    def text(self) -> str:
        """The combination in a line."""
        shares = [f"{name.replace('_', ' ')} {100 * share:.3g} %" for name, share in self.rest.items()]
        rest = ", ".join([*shares[:MOST_LEFT], *([".."] if len(shares) > MOST_LEFT else [])])
        said = in_words(self.terms) if self.terms else rest + " of its square"
        said += f" = {self.value.text()}" if self.value else ""
        said += f" with {rest} of its square" if self.terms and rest else ""
        return f"{said}: to {100 * self.known:.3g} % of the range of the drawing"


def field_of(name: str) -> str:
    """Field of an element: "crank_phase[1]" -> "crank_phase"."""
    return place_of(name)[0]


def unit_of(answer: Identified, name: str) -> tuple[str, str, float]:
    """SI unit of an element, and name and size of the unit in which a person reads it.

    Args:
        answer: with its study.
        name: of the element.
    """
    field = field_of(name)
    unit = field_unit(answer.study.design, field)
    if field in NUISANCES and unit == "rad":
        return unit, "arcsec", arcsec
    return (unit, "N/um", KNOWN["N/m"]["N/um"]) if unit == "N/m" else (unit, *readable(unit))


def in_words(terms: Mapping[str, float]) -> str:
    """A sum as a person writes it: "crank eccentricity [0,0] - [0,1] - [1,0] + [1,1]".

    Args:
        terms: {element: factor}.
    """
    alike = all(abs(size) == 1 for size in terms.values())
    said, field = "", ""
    for name, size in terms.items():
        own = field_of(name)
        place = name[len(own) :]
        factor = "" if alike else f"{abs(size):.2g} "
        shown = place if own == field and place else " ".join([own.replace("_", " "), place]).strip()
        sign = "-" if size < 0 else "+"
        said += f" {sign} {factor}{shown}" if said else f"{factor}{shown}"
        field = own
    return said


def combinations(answer: Identified) -> list[Combination]:
    """Combinations that the data determine, strongest first."""
    prior = answer.problem.prior.items()
    sd = elements({name: np.broadcast_to(np.sqrt(own.moments()[1]), own.shape) for name, own in prior})
    return [_combination(answer, direction, sd) for direction in answer.check.directions]


def _combination(answer: Identified, direction: identify.Direction, sd: Mapping[str, float]) -> Combination:
    square = {name: size**2 for name, size in direction.loadings.items()}
    whole, largest = sum(square.values()), max(square.values())
    named = [name for name in square if square[name] >= SHOWN**2 * largest]
    named = named if len(named) <= MOST_TERMS else []
    units = {unit_of(answer, name)[0] for name in named}
    terms = {name: direction.loadings[name] / (sd[name] if len(units) == 1 else 1.0) for name in named}
    rest: dict[str, float] = {}
    for name in square.keys() - terms.keys():
        rest[field_of(name)] = rest.get(field_of(name), 0.0) + square[name] / whole
    known = 1 / math.sqrt(1 + direction.information)
    seen = sorted((name for name in rest if rest[name] > known**2), key=lambda name: (-rest[name], name))
    terms = rounded(terms)
    value = _value(answer, terms) if len(units) == 1 and answer.posterior is not None else None
    return Combination(terms, {name: rest[name] for name in seen}, known, value)


def rounded(terms: Mapping[str, float]) -> dict[str, float]:
    """Factors as they are written, the largest 1 and the first positive."""
    largest = max(map(abs, terms.values()), default=1.0)
    lead = math.copysign(largest, next(iter(terms.values()), 1.0))
    sizes = {name: float(f"{size / lead:.2g}") for name, size in terms.items()}
    if all(abs(size) >= 1 - EQUAL for size in sizes.values()):
        return {name: math.copysign(1.0, size) for name, size in sizes.items()}
    return sizes


def _value(answer: Identified, terms: Mapping[str, float]) -> Quantity:
    """A sum of elements with its interval, from the normal distribution about the mode."""
    found = answer.posterior
    assert found is not None
    value, lower, upper = (elements(x) for x in (found.value, found.lower, found.upper))
    places = [found.names.index(name) for name in terms]
    half = np.array([factor * (upper[name] - lower[name]) / 2 for name, factor in terms.items()])
    half /= np.asarray(found.u_sd)[places]
    spread = math.sqrt(max(half @ np.asarray(found.u_covariance)[np.ix_(places, places)] @ half, 0.0))
    total = sum(factor * value[name] for name, factor in terms.items())
    unit, shown, _ = unit_of(answer, next(iter(terms)))
    return Quantity(total, unit, total - spread, total + spread, shown)


def elements(structure: Mapping[str, PyTree]) -> dict[str, float]:
    """{element: number} of values with the structure of a prior."""
    found = {}
    for name in sorted(structure):
        values = np.asarray(structure[name], float)
        for place in np.ndindex(values.shape):
            found[element(name, place)] = float(values[place])
    return found


def doubts(answer: Identified) -> list[str]:
    """Reasons not to trust values and intervals as they are, each with what to do."""
    found, lines, more = answer.posterior, [], "" if answer.draws else "; run again with --sample"
    if found is not None and found.modes:
        heavy = [f"{100 * mode.weight:.3g} %" for mode in found.modes if mode.weight > identify.FAINT]
        if len(heavy) > 1:
            shared = f"{len(heavy)} solutions explain the data, with the probabilities {', '.join(heavy)}"
            lines.append(f"warning: {shared}: values and intervals are those of the first{more}")
        if not (k := found.laplace.pareto_k) <= identify.MOST_PARETO:
            lines.append(f"warning: Pareto k = {k:.2g}, above {identify.MOST_PARETO}: the intervals do not hold{more}")
    if answer.draws is not None and not answer.draws.trusted:
        r_hat = float(np.max(answer.draws.r_hat))
        lines.append(f"warning: sampled chains do not agree (r_hat {r_hat:.4f}): another mode, or too few draws")
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
