"""Identification from a measured curve: identifiable errors, most probable values, next measurement."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from rvjax import identify
from rvjax.base import progress
from rvjax.base.fields import place_of
from rvjax.measured import KINDS, Finding, foreign, judge
from rvjax.records import PyTree
from rvjax.study import (
    NUISANCES,
    Measured,
    Problem,
    Run,
    Study,
    candidates,
    field_unit,
    inverse_problem,
    kind_of,
    order_name,
    orders_of,
)
from rvjax.units import KNOWN, arcsec, readable

REJECTED = ("REJECTED", "MAX_STEPS", "NONFINITE")
"""Statuses without a result."""
POINTS = 181  # of the plotted curve
PITCHES = 3  # of the ring over which a curve is plotted
WITHOUT = 1e-4
"""Resolution below which the data say nothing of an element."""

BEFORE = "the runs of the study"
SEEING, FITTING, RANKING = "identifiability", "most probable values", "what to measure next"


@dataclass(frozen=True)
class Band:
    """One measured run and the prediction of the identified unit.

    Attributes:
        run: as measured, without drift, lines and bad readings.
        angle: of the output, rad (n,).
        value: predicted error, rad (n,).
        lower: of the 95 % band.
        upper: of the same.
        taken: from the measurement before plotting: its mean, without an offset in the prior, and order 1; rad, as a
            function of the angle through its coefficients [mean, cosine, sine].
    """

    run: Run
    angle: np.ndarray
    value: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    taken: tuple[float, float, float]


@dataclass(frozen=True)
class Identified:
    """Result of `rvjax identify`.

    Attributes:
        problem: the question with its data.
        check: what the data can identify, without them.
        posterior: of one unit, or None.
        batch: of several units, or None.
        draws: of the sampler, or None.
        gains: {candidate: nats that measuring it next would bring}, best first; empty where there are no candidates.
        bands: of every run of one unit, where it is a curve.
    """

    problem: Problem
    check: identify.Identifiability
    posterior: identify.Posterior | None = None
    batch: identify.Batch | None = None
    draws: identify.Draws | None = None
    gains: Mapping[str, float] | None = None
    bands: tuple[Band, ...] = ()

    @property
    def study(self) -> Study:
        """The question."""
        return self.problem.study

    @property
    def adequate(self) -> bool | None:
        """True if the model explains the data and the solver converged; None for a check."""
        if self.posterior is not None:
            return bool(self.posterior.adequate) and self.posterior.status not in REJECTED
        return None if self.batch is None else not any(status in REJECTED for status in self.batch.status)

    @property
    def converged(self) -> bool:
        """True if every unit has the status CONVERGED: one solution, whose intervals hold."""
        found = [] if self.posterior is None else [self.posterior.status]
        found += [] if self.batch is None else list(self.batch.status)
        return all(status == "CONVERGED" for status in found)

    @property
    def findings(self) -> dict[str, tuple[Finding, ...]]:
        """Findings of every measurement, by unit and conditions."""
        kind, found = KINDS[self.problem.kind], {}
        design = self.study.design
        parts, multiples = orders_of(design), kind_of(design).multiples(design)
        for item in (item for items in self.problem.items for item in items):
            name = f"{item.at.unit} {item.at.text()}".strip()
            while name in found:
                name += " again"
            found[name] = kind.findings(item, parts)
            if isinstance(item, Run):
                found[name] += foreign(judge(item, parts), multiples)
        return found

    @property
    def silent(self) -> list[str]:
        """Elements of which the data say nothing; their values are those of the drawing."""
        return [name for name in self.check.names if self.check.resolution[name] < WITHOUT]


def check(study: Study, measured: Measured | None = None) -> Identified:
    """Evaluate what a bench can identify and the next run; requires no values, and no data if the noise is known.

    Args:
        study: with [identify].
        measured: runs that replace those of the study.

    Raises:
        ValueError: as `rvjax.study.inverse_problem`.
    """
    progress.begin(SEEING)
    case = inverse_problem(study, measured)
    return Identified(case, _seen(case), gains=_gains(case, None))


def answer(study: Study, measured: Measured, *, draws: bool = False) -> Identified:
    """Most probable values of a unit, or of every unit of a batch, with everything that `check` says.

    Args:
        study: with [identify].
        measured: what the bench wrote.
        draws: sample the posterior of a unit too.

    Raises:
        ValueError: as `rvjax.study.inverse_problem`; draws of a batch.
    """
    progress.begin(SEEING)
    case = inverse_problem(study, measured)
    seen = _seen(case)
    progress.begin(FITTING)
    options: dict[str, PyTree] = dict(noise=case.noise, nuisance=case.nuisance, seed=study.seed)
    if len(case.units) > 1 or case.identification.shared:
        if draws:
            raise ValueError(f"--sample: {len(case.units)} units; sample one at a time")
        batch = identify.solve_many(
            case.model, case.prior, case.stacked(), shared=case.identification.shared, **options
        )
        return Identified(case, seen, batch=batch, gains=_gains(case, None))
    starts = 16 if "phase" in case.nuisance else 8
    found = identify.solve(case.model, case.prior, case.data[0], starts=starts, **options)
    return Identified(
        case,
        seen,
        posterior=found,
        draws=identify.sample(found, seed=study.seed) if draws else None,
        gains=_gains(case, found),
        bands=_bands(case, found) if case.kind == "curve" and found.status not in ("NONFINITE", "MAX_STEPS") else (),
    )


def _seen(case: Problem) -> identify.Identifiability:
    return identify.identifiability(case.model, case.prior, noise=case.noise, nuisance=case.nuisance)


def _gains(case: Problem, given: identify.Posterior | None) -> dict[str, float]:
    """Gain of each candidate, best first: over the posterior, or over the runs of the study."""
    progress.begin(RANKING)
    coming = candidates(case)
    if not coming or (given is not None and not given.modes):
        return {}
    models, noise = ({name: getattr(one, key) for name, one in coming.items()} for key in ("model", "noise"))
    if given is None:
        models, noise = models | {BEFORE: case.model}, noise | {BEFORE: case.noise}
    found = identify.rank_measurements(
        case.prior, models, noise=noise, nuisance=case.nuisance, given=given, already="" if given else BEFORE
    ).gains
    return {name: found[name] for name in sorted(coming, key=lambda name: -found[name])}


def _bands(case: Problem, found: identify.Posterior) -> tuple[Band, ...]:
    """Compare the measured runs with the identified unit, over a few pitches of the ring.

    The band is that of Laplace's method: an observation is linear in u about the mode, a curve in its observation.
    """
    study, orders = case.study, case.identification.orders
    peak, layout = found.peaks[0], found.problem.layout
    mean = layout.tree(peak.observation)
    # One row for each independent number behind u, as changes of the observation.
    slopes = found.problem.sd[:, None] * peak.slopes @ found.problem.elements.mixing @ peak.spectrum.root
    changes = layout.tree(np.ascontiguousarray(slopes.T))
    angle = np.linspace(0, 2 * np.pi * PITCHES / study.design.cycloid.pin_count, POINTS)
    wave = np.exp(1j * np.outer(orders, angle))
    offset = "offset" in case.nuisance

    def curve(seen: Mapping[str, object], r: int) -> np.ndarray:
        rows = np.stack([np.asarray(seen[order_name(k)])[..., r] for k in orders], axis=-1)
        return np.real(rows @ wave) + (np.asarray(seen["mean"])[..., r, None] if offset else 0.0)

    bands = []
    for r, run in enumerate(case.items[0]):
        assert isinstance(run, Run)
        judged = judge(run, orders_of(study.design))
        run = replace(run, angle=judged.angle, error=judged.error)  # without drift, lines and bad readings
        value, half = curve(mean, r), 1.96 * np.sqrt(np.sum(curve(changes, r) ** 2, axis=0))
        fitted = identify.orders(run.angle, run.error, sorted({1, *orders}))
        one = complex(np.asarray(fitted.value)[0])
        taken = (0.0 if offset else float(fitted.mean), one.real, -one.imag)
        taken = (taken[0], 0.0, 0.0) if 1 in orders else taken
        bands.append(Band(run, angle, value, value - half, value + half, taken))
    return tuple(bands)


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
