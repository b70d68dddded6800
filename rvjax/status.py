"""Why a solved value is, or is not, to be trusted: `Status`, `SolveInfo`, `check`."""

import enum
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import Record, field, record

Result = TypeVar("Result")


class Status(enum.IntEnum):
    """Outcome of one solved lane. `PRECEDENCE` orders them from worst to best.

    NONFINITE stands for NaN and infinity among the inputs, and as well for finite inputs that are too large or too
    small for the arithmetic: a power or product of them on the way overflows or vanishes.
    """

    CONVERGED = 0
    NO_BRACKET = 1
    MAX_STEPS = 2
    NONFINITE = 3
    SINGULAR = 4
    INVALID_GEOMETRY = 5
    UNDERCUT = 6
    CONTACT_OVERLOAD = 7
    NOT_ASSEMBLABLE = 8
    PRESSURE_ANGLE = 9
    CHANGE_POINT = 10
    UNSTABLE = 11
    UNLOADED = 12


PRECEDENCE = (
    Status.NONFINITE,
    Status.INVALID_GEOMETRY,
    Status.UNDERCUT,
    Status.CONTACT_OVERLOAD,
    Status.NO_BRACKET,
    Status.MAX_STEPS,
    Status.NOT_ASSEMBLABLE,
    Status.PRESSURE_ANGLE,
    Status.CHANGE_POINT,
    Status.SINGULAR,
    Status.UNSTABLE,
    Status.UNLOADED,
    Status.CONVERGED,
)
"""Worst first: of several lanes, angles or discs the first that occurs speaks for all."""

SUCCESS = (Status.UNLOADED, Status.CONVERGED)

MEANING = {
    Status.NONFINITE: "an input is not finite, or too large or too small for the arithmetic",
    Status.INVALID_GEOMETRY: "lengths or angles that no such part can have",
    Status.UNDERCUT: "the tooth flank cuts into itself",
    Status.CONTACT_OVERLOAD: "a contact is wider than its theory holds",
    Status.NO_BRACKET: "no sign change of the equation was found",
    Status.MAX_STEPS: "the solver did not finish in its steps",
    Status.NOT_ASSEMBLABLE: "the parts cannot be put together without deformation",
    Status.PRESSURE_ANGLE: "a pressure angle whose cosine lies outside 0 to 1",
    Status.CHANGE_POINT: "a linkage at its dead point, where two closures meet",
    Status.SINGULAR: "equations without a unique solution",
    Status.UNSTABLE: "the vibration grows from period to period",
    Status.UNLOADED: "no contact carries load; a success",
    Status.CONVERGED: "solved; a success",
}
"""Why, for a person."""

_RANK = np.zeros(len(PRECEDENCE), np.int32)
_RANK[[int(status) for status in PRECEDENCE]] = np.arange(len(PRECEDENCE))
_ORDER = np.array([int(status) for status in PRECEDENCE], np.int32)


@record
class SolveInfo(Record):
    """How a solve ended; vmaps like any record."""

    status: Any = field("-", "a Status value", kind="integer")
    steps: Any = field("-", "iterations taken (0 for closed forms)", default=0, kind="integer")
    residual: Any = field("-", "size of what the solver drives to zero, at the result", default=0.0)


class SolveError(RuntimeError):
    """Raised by `check`: more lanes failed than allowed."""


def worst(status: jax.Array, axis: int | tuple[int, ...] | None = None) -> jax.Array:
    """The status that speaks for several, by `PRECEDENCE`.

    Args:
        status: integer array.
        axis: reduced; None reduces all.
    """
    rank = jnp.asarray(_RANK)[status]
    return jnp.asarray(_ORDER)[jnp.min(rank, axis=axis)]


def first_failure(*checks: tuple[jax.Array, Status]) -> jax.Array:
    """The first status whose condition holds, CONVERGED where none does; elementwise.

    Args:
        *checks: (failed, status) pairs, given in any order; `PRECEDENCE` decides.
    """
    ordered = sorted(checks, key=lambda pair: PRECEDENCE.index(pair[1]), reverse=True)
    status = jnp.asarray(int(Status.CONVERGED), jnp.int32)
    for failed, name in ordered:
        status = jnp.where(failed, jnp.int32(int(name)), status)
    return status


def succeeded(status: jax.Array) -> jax.Array:
    """True where a status counts as success: CONVERGED and UNLOADED."""
    return (status == Status.CONVERGED) | (status == Status.UNLOADED)


def check(result: Result, max_failed_fraction: float = 0.0) -> Result:
    """Return `result`, or raise if too many of its lanes failed; for use outside jit.

    Args:
        result: any solved result (a record with a field `info`), of one case or of a batch.
        max_failed_fraction: share of lanes that may fail, 0 to 1.

    Raises:
        SolveError: names the reasons, their counts and the first failed lane of each.
        TypeError: `result` carries no `info`.
    """
    info = getattr(result, "info", None)
    if not isinstance(info, SolveInfo):
        raise TypeError(f"check needs a solved result with a field 'info', got {type(result).__name__}")
    status = np.atleast_1d(np.asarray(info.status))
    good = np.isin(status, [int(name) for name in SUCCESS])
    failed = status.size - int(good.sum())
    if failed > max_failed_fraction * status.size:
        reasons = []
        for name in PRECEDENCE:
            lanes = np.argwhere(status == int(name))
            if name not in SUCCESS and len(lanes):
                reasons.append(f"{name.name} {len(lanes)} (first at index {tuple(map(int, lanes[0]))})")
        raise SolveError(f"{failed} of {status.size} cases failed: " + ", ".join(reasons))
    return result
