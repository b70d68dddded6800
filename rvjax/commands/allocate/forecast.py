"""Forecast of an allocation: phases, solved units of each, seconds."""

from rvjax.base.progress import spelled
from rvjax.commands.forecast import unit_seconds
from rvjax.response import BLOCK
from rvjax.study import Study
from rvjax.tolerances import COSTLY_UNITS, KEPT, QUICK, units_of

SEARCHING, CERTIFYING = "cheapest tolerances", "yield before"  # phases of a run
SAMPLING, PRICING = "sample units", "cost against yield"
SHOWN_VALUES = KEPT  # units behind a histogram: those of the certificate where it has no more
FEWEST_BEYOND = 8  # units of the learning sample beyond a limit, below which a point of the cost curve is left out
YIELD_SWEEP = (0.9, 0.95, 0.99, 0.995, 0.999)

# Counted in results of rv-40e, with moving mid-points and half-widths rounded to grades, and of rv-40e-whole.
PASSES = {True: 360, False: 60}  # of a search and its cost curve over its sample, with and without moving mid-points
CERTIFICATES = {True: 5, False: 4}
PASSES_A_POINT = 6  # of the cost curve
# The same of rv-40e-whole, whose units are costly: the sample grows, and a point of the cost curve has few units.
COSTLY_PASSES, COSTLY_CERTIFICATES, COSTLY_POINT = 13, 6, 8192
COMPILING = {True: "30 s for a loaded RV-40E, 60 s", False: "20 s for an RV-40E, 45 s"}


def solved_units(study: Study) -> dict[str, int]:
    """Estimate the number of solved units in each phase of a run, in their order."""
    middles, drawn, points = bool(study.middles), study.certificate_samples, len(targets(study))
    shown = 2 * SHOWN_VALUES if drawn > KEPT else 0
    if study.costly:
        found = {
            SEARCHING: COSTLY_PASSES * study.samples + COSTLY_CERTIFICATES * drawn,
            CERTIFYING: min(drawn, QUICK),
            SAMPLING: COSTLY_UNITS * (1 + len(study.fields)) + shown,
            PRICING: points * COSTLY_POINT,
        }
    else:
        found = {
            SEARCHING: PASSES[middles] * QUICK + CERTIFICATES[middles] * units_of(study.requirements, drawn),
            CERTIFYING: drawn,
            SAMPLING: shown,
            PRICING: points * (PASSES_A_POINT * study.samples + shown_values(study)),
        }
    return {phase: int(units) for phase, units in found.items()}


def targets(study: Study) -> list[float]:
    """Target yields of the points of the cost curve; none if no requirement has a target."""
    if all(requirement.goal != "target" for requirement in study.requirements.values()):
        return []
    return [target for target in YIELD_SWEEP if study.samples * (1 - target) >= FEWEST_BEYOND]


def shown_values(study: Study) -> int:
    """Units behind a histogram."""
    return min(SHOWN_VALUES, study.certificate_samples)


def seconds_of_units(study: Study) -> float | None:
    """Seconds of two cores that the units of an allocation take, if they are costly; 0 for others, None if unknown."""
    unit = unit_seconds(study) if study.costly else 0.0
    return unit and unit * sum(solved_units(study).values())


def expected(study: Study) -> str:
    """Time and memory of an allocation, from the measured time of a unit, in words."""
    unit = unit_seconds(study)
    if unit is None:
        return "time: unknown, these levels are not measured"
    return (
        f"time: about {spelled(unit * sum(solved_units(study).values()))} of computation on the two cores of the "
        f"measured table, besides tracing and compilation ({COMPILING[study.costly]} at the first run); "
        f"chunks of {BLOCK:,} units, memory does not grow with their number"
    )


def phases_of(before: str, *after: str) -> tuple[str, ...]:
    """Phases of a run.

    Args:
        before: phase before it.
        *after: phases after it.
    """
    return before, SEARCHING, CERTIFYING, SAMPLING, PRICING, *after
