"""Cells of several commands: limits of errors, evaluated values of requirements, failed units."""

import math

from rvjax.outputs import Output
from rvjax.render import Quantity, Zone
from rvjax.study import Study
from rvjax.tolerances import Estimate, Limits, Statistics, Tolerance, Verdict


def limits_of(study: Study, field: str, tolerance: Tolerance) -> Zone:
    """The limits of an error, as the study states them: like a drawing, or about their mid-point.

    Args:
        study: that the error belongs to.
        field: name of the error.
        tolerance: of the error; not that of the study where it is allocated.
    """
    ends = float(tolerance.middle), study.unit(field), float(tolerance.lower), float(tolerance.upper)
    form = study.forms.get(field)
    if form is None or not form.stated or (drawn := form.number(tolerance)) is None:
        return Zone(*ends)
    return Zone(*ends, stated=form.stated, drawn=drawn)


def limit_text(requirement: Limits, output: Output) -> str:
    """The limits of a response, such as "<= 1 arcmin".

    Args:
        requirement: with its limits.
        output: what the response is.
    """
    unit, size = output.shown
    bounds = ((">=", requirement.lower), ("<=", requirement.upper))
    return " and ".join(f"{sign} {limit / size:.4g} {unit}" for sign, limit in bounds if math.isfinite(limit))


def share(estimate: Estimate) -> Quantity:
    """A yield with its interval."""
    return Quantity.of(estimate, read_in="%", form=".3f")


def evaluated(verdict: Verdict, output: Output) -> Quantity:
    """The value that a requirement evaluates, with its interval.

    Args:
        verdict: on the requirement.
        output: what the response is.
    """
    if verdict.kind == "share":
        return share(verdict.estimate)
    if verdict.kind == "response":
        return Quantity.of(verdict.estimate, output.unit, output.read_in)
    return Quantity.of(verdict.estimate)


def met_text(requirement: Limits, verdict: Verdict, samples: int) -> str:
    """Text on a requirement: met, not met, or met by the estimate while the interval of so few units is too wide.

    Args:
        requirement: as required.
        verdict: on it.
        samples: units behind the verdict.
    """
    one, value = verdict.estimate, verdict.estimate.value
    if verdict.met:
        return "met"
    unsure = requirement.holds(Estimate(value, 0.0, value, value)) and not requirement.holds(one)
    return f"not shown with {samples:,} units" if unsure else "not met"


def failures_text(found: Statistics) -> str:
    """Text on failed units: number, statuses, and one unit of each status."""
    if not found.failed:
        return "0 failed"
    kinds = (f"{count:,} {name} (unit {found.examples[name]})" for name, count in found.failures.items())
    return f"{found.failed:,} failed, each a reject in every yield: {', '.join(kinds)}"


def limits_data(study: Study, field: str, tolerance: Tolerance) -> dict[str, object]:
    """Limits and distribution of a tolerance as JSON values, SI, with form and number of the drawing if it has them.

    Args:
        study: that the error belongs to.
        field: name of the error.
        tolerance: of the error.
    """
    lower, upper, cp, shift = (float(getattr(tolerance, name)) for name in ("lower", "upper", "cp", "shift"))
    zone = limits_of(study, field, tolerance)
    drawn = {} if zone.drawn is None else {"form": zone.stated, "drawing": zone.drawn}
    return {"lower": lower, "upper": upper, "distribution": tolerance.distribution, "cp": cp, "shift": shift, **drawn}


def assumed_text(study: Study) -> str:
    """List the assumed values; if all values of a part are assumed, only the part."""
    stated = [number for number in study.numbers if number.origin != "default"]
    known = {number.path.rpartition(".")[0] for number in stated if not number.assumed} | {""}
    paths = (number.path for number in stated if number.assumed)
    parts = (path if path.rpartition(".")[0] in known else path.rpartition(".")[0] for path in paths)
    return ", ".join(dict.fromkeys(parts))
