"""An identification in words: combinations of errors, verdicts, the encoder head, what to measure next.

The six numbers of the nuisance "reading" are linear in the observation, so that their posterior has one maximum and
misfits of a direction are never attributed to errors of parts. Whether one head explains them is a test of its own.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from rvjax import identify
from rvjax.base.fields import element
from rvjax.commands.identify.identified import Identified, field_of, unit_of
from rvjax.loaded import HEAD_PARTS
from rvjax.render import Quantity
from rvjax.units import arcsec, deg


@dataclass(frozen=True)
class Head:
    """One head that the six numbers of a reading describe; intervals of 95 %.

    Attributes:
        angle: direction from pin 0, [value, lower, upper] rad. The scale is taken to lie on the side of the last disc;
            on the other side it is half a turn more. NaN where several directions explain the numbers alike.
        amplitudes: {"ring", "tilt" or "dent": [value, lower, upper] rad}, of the largest order at the rated torque; > 0
            for the ring and the tilt. Parts that the data do not see are missing.
        p: probability of six numbers at least as far from those of one head; NaN for one part alone.
    """

    angle: tuple[float, float, float]
    amplitudes: dict[str, tuple[float, float, float]]
    p: float


CONSISTENT = 1e-3
"""Least p of numbers that one head explains."""
SEEN = 0.1  # standard deviation of a number that the data see, of its prior
BAND = float(stats.norm.ppf(0.975))
GRID = 360  # directions over half a turn


def one_head(values: Sequence[float] | np.ndarray, covariance: np.ndarray, prior: float) -> Head | None:
    """The head whose gains and one direction come closest to the six numbers of "reading"; None if none is seen.

    Weighted least squares over direction and gains; a direction and the one half a turn further fit alike, with
    opposite tilt and dent. The interval of the direction is that of the profile of chi-square.

    Args:
        values: [cosine, sine] of ring, tilt and dent, rad (6,).
        covariance: of them, rad^2 (6, 6).
        prior: their standard deviation before the measurement, rad.
    """
    numbers, cov = np.asarray(values, float), np.asarray(covariance, float)
    sd = np.sqrt(np.diag(cov)).reshape(3, 2).max(axis=1)
    parts = [k for k in range(3) if sd[k] < SEEN * prior]
    if not parts:
        return None
    names = [list(HEAD_PARTS)[k] for k in parts]
    periods = np.array([HEAD_PARTS[name] for name in names])
    own = np.concatenate([[2 * k, 2 * k + 1] for k in parts])
    white = np.linalg.inv(np.linalg.cholesky(cov[np.ix_(own, own)]))
    measured = white @ numbers[own]

    def columns(angle: np.ndarray, shift: float = 0.0) -> np.ndarray:
        """Whitened numbers of a head per gain, (n, 2 k, k); `shift` of a quarter turn: their derivatives over m."""
        phase = periods * angle[:, None] + shift
        made = np.zeros((len(angle), len(own), len(parts)))
        row = np.arange(len(own))
        made[:, row, row // 2] = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(angle), -1)
        return np.asarray(white @ made)

    def gains(angle: np.ndarray) -> np.ndarray:
        """Best gains of directions, (n, k); that of the ring, a compliance, is not negative."""
        made = columns(angle)
        best = np.linalg.pinv(made) @ measured
        if names[0] == "ring" and np.any(under := best[:, 0] < 0):
            made[under, :, 0] = 0.0
            best[under] = np.linalg.pinv(made[under]) @ measured
        return np.asarray(best)

    def chi2(angle: float | np.ndarray) -> np.ndarray:
        angle = np.atleast_1d(angle)
        return np.asarray(np.sum((measured - (columns(angle) @ gains(angle)[..., None])[..., 0]) ** 2, axis=1))

    step = np.pi / GRID
    start = step * int(np.argmin(chi2(step * np.arange(GRID))))
    near = optimize.minimize_scalar(lambda x: chi2(x)[0], bounds=(start - step, start + step), method="bounded")
    angle = float(near.x)
    least, found = float(chi2(angle)[0]), gains(np.array([angle]))[0]
    signed = dict(zip(names, found))
    if signed.get("tilt", 0.0) < 0:
        angle, found = angle + np.pi, found * np.where(periods % 2, -1.0, 1.0)
    angle %= 2 * np.pi

    def beyond(change: np.ndarray) -> np.ndarray:
        return chi2(angle + change) - least - BAND**2

    ends = [_first(beyond, side * step) for side in (-1.0, 1.0)]
    others = np.arange(ends[1] + step, np.pi + ends[0], step) if np.all(np.isfinite(ends)) else np.zeros(1)
    alone = bool(np.all(beyond(others) > 0))
    at = np.array([angle])
    slopes = np.column_stack([columns(at, np.pi / 2)[0] @ (periods * found), columns(at)[0]])
    half = BAND * np.sqrt(np.diag(np.linalg.pinv(slopes.T @ slopes)))[1:]
    freedom = len(parts) - 1
    return Head(
        (angle, angle + ends[0], angle + ends[1]) if alone else (np.nan, np.nan, np.nan),
        {name: (float(g), float(g - h), float(g + h)) for name, g, h in zip(names, found, half)},
        float(stats.chi2.sf(least, freedom)) if freedom else np.nan,
    )


def _first(function: Callable[[np.ndarray], np.ndarray], step: float) -> float:
    """First zero of a function that is negative at 0, within half a turn in steps; NaN if there is none."""
    above = np.flatnonzero(function(step * np.arange(1, GRID)) > 0)
    if not len(above):
        return np.nan
    ends = (step * above[0], step * (above[0] + 1))
    return float(optimize.brentq(lambda x: function(np.atleast_1d(x))[0], *ends))


def head_of(found: identify.Posterior) -> Head | None:
    """The head of an identification; None without the nuisance "reading", or where the data do not see it.

    Args:
        found: of one unit.
    """
    own = [k for k, name in enumerate(found.names) if name.startswith("reading[")]
    if len(own) != 2 * len(HEAD_PARTS) or not np.all(np.isfinite(found.u)):
        return None
    lower, upper = (np.asarray(x["reading"], float) for x in (found.lower, found.upper))
    u_sd = np.asarray(found.u_sd)[own]
    size = (upper - lower) / (2 * BAND * u_sd)  # of a standard deviation of the prior: the prior is normal
    covariance = np.asarray(found.u_covariance)[np.ix_(own, own)] * np.outer(size, size)
    return one_head(np.asarray(found.value["reading"], float), covariance, float(size.max()))


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


def elements(structure: Mapping[str, object]) -> dict[str, float]:
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
    counts = Counter(answer.check.verdict[name] for name in own)
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
