"""Cells of several commands: limits of errors, evaluated values of requirements, failed units."""

import math

from rvjax.outputs import Output
from rvjax.render import Quantity
from rvjax.study import Study
from rvjax.tolerances import Estimate, Limits, Statistics, Tolerance, Verdict


def limits_of(tolerance: Tolerance, unit: str) -> Quantity:
    """The limits of an error about its mid-point.

    Args:
        tolerance: of the error.
        unit: SI unit of the error.
    """
    return Quantity(float(tolerance.middle), unit, float(tolerance.lower), float(tolerance.upper))


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


def failures_text(found: Statistics) -> str:
    """Text on failed units: number, statuses, and one unit of each status."""
    if not found.failed:
        return "0 failed"
    kinds = (f"{count:,} {name} (unit {found.examples[name]})" for name, count in found.failures.items())
    return f"{found.failed:,} failed, each a reject in every yield: {', '.join(kinds)}"


def limits_data(tolerance: Tolerance) -> dict[str, object]:
    """Limits and distribution of a tolerance as JSON values, SI."""
    lower, upper, cp, shift = (float(getattr(tolerance, name)) for name in ("lower", "upper", "cp", "shift"))
    return {"lower": lower, "upper": upper, "distribution": tolerance.distribution, "cp": cp, "shift": shift}


def assumed_text(study: Study) -> str:
    """List the assumed values; if all values of a part are assumed, only the part."""
    stated = [number for number in study.numbers if number.origin != "default"]
    known = {number.path.rpartition(".")[0] for number in stated if not number.assumed} | {""}
    paths = (number.path for number in stated if number.assumed)
    parts = (path if path.rpartition(".")[0] in known else path.rpartition(".")[0] for path in paths)
    return ", ".join(dict.fromkeys(parts))
