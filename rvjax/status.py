"""Status of a solved value: `Status`, `SolveInfo`, `check`."""

import enum
import functools
import operator
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.base.fields import numbers_of, value_text
from rvjax.records import Array, PyTree, Record, field, record

Result = TypeVar("Result")


class Status(enum.IntEnum):
    """Outcome of one solved case. `PRECEDENCE` orders them from worst to best.

    NONFINITE means NaN and infinity among the inputs, and as well for finite inputs that are too large or too
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
"""Worst first: of several batch elements, angles or discs the first that occurs is returned."""

SUCCESS = (Status.UNLOADED, Status.CONVERGED)

WITHOUT_VALUE = PRECEDENCE[: PRECEDENCE.index(Status.NOT_ASSEMBLABLE) + 1]
"""Statuses with the value NaN; the others keep the value."""

MEANING = {
    Status.NONFINITE: "an input is not finite, or too large or too small for the arithmetic",
    Status.INVALID_GEOMETRY: "impossible lengths or angles",
    Status.UNDERCUT: "the tooth flank cuts into itself",
    Status.CONTACT_OVERLOAD: "a contact is too wide for its theory",
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
"""Meaning of each status, for messages."""

_RANK = np.zeros(len(PRECEDENCE), np.int32)
_RANK[[int(status) for status in PRECEDENCE]] = np.arange(len(PRECEDENCE))
_ORDER = np.array([int(status) for status in PRECEDENCE], np.int32)


Statuses = TypeVar("Statuses", jax.Array, np.ndarray)
Check = tuple[Any, Status]  # a condition, and what it is called where it holds


@record
class SolveInfo(Record):
    """Status, iterations and residual of a solve; vmaps like any record."""

    status: Array = field("-", "a Status value", kind="integer")
    steps: Array = field("-", "iterations taken (0 for closed forms)", default=0, kind="integer")
    residual: Array = field("-", "size of what the solver drives to zero, at the result", default=0.0)

    def __repr__(self) -> str:
        lanes = numbers_of(self.status)
        if lanes is None:
            return super().__repr__()
        found = [(s, int((lanes == s).sum())) for s in np.unique(lanes)]
        names = {int(status): status.name for status in Status}
        status = ", ".join((f"{count} " if lanes.ndim else "") + names.get(s, str(s)) for s, count in found)
        steps, residual = value_text(self.steps, "-"), value_text(self.residual, "-")
        return f"SolveInfo({status}, steps={steps}, residual={residual})"


class SolveError(RuntimeError):
    """Raised by `check`: more cases failed than allowed."""


def worst(status: Statuses, axis: int | tuple[int, ...] | None = None) -> Statuses:
    """Return the worst of several statuses, by `PRECEDENCE`, as an array of the library of the given one.

    Args:
        status: integer array.
        axis: reduced; None reduces all.
    """
    if isinstance(status, np.ndarray):  # a dozen programs for each shape otherwise
        return _ORDER[np.min(_RANK[status], axis=axis)]
    rank = jnp.asarray(_RANK)[status]
    return jnp.asarray(_ORDER)[jnp.min(rank, axis=axis)]


def converged(residual: Array, steps: Array | int = 0) -> SolveInfo:
    """Return the info of a successful solve.

    Args:
        residual: as in `SolveInfo`.
        steps: as in `SolveInfo`.
    """
    return SolveInfo(
        jnp.zeros_like(residual, jnp.int32), jnp.broadcast_to(steps, residual.shape).astype(jnp.int32), residual
    )


def at_once(like: Array) -> SolveInfo:
    """Return the info of a closed form: residual zero.

    Args:
        like: any number of the result, for its shape and dtype.
    """
    return converged(jnp.zeros_like(like))


def worst_of(infos: SolveInfo) -> SolveInfo:
    """Return the info of several solves: worst status, most steps, largest residual."""
    return SolveInfo(worst(infos.status), jnp.max(infos.steps), jnp.max(infos.residual))


def first_failure(*checks: Check, otherwise: Array | Status = Status.CONVERGED) -> jax.Array:
    """The first status whose condition holds; elementwise.

    Args:
        *checks: (failed, status) pairs, given in any order; `PRECEDENCE` decides.
        otherwise: the status where no condition holds.
    """
    status = jnp.asarray(otherwise, jnp.int32)
    for failed, name in sorted(checks, key=lambda pair: PRECEDENCE.index(pair[1]), reverse=True):
        status = jnp.where(failed, jnp.int32(int(name)), status)
    return status


class Gate(NamedTuple):
    """Checks at the entry of a model; `close` sets status and NaN of its results.

    A case that fails a check is solved with harmless numbers, so that no derivative meets 0 * inf. It keeps the
    status of the failed check.
    """

    refused: tuple[Check, ...]

    @property
    def good(self) -> PyTree:
        """True for a case that passed."""
        return functools.reduce(operator.and_, [~failed for failed, _ in self.refused])

    def close(self, values: object, *checks: Check, info: SolveInfo | None = None) -> tuple[PyTree, SolveInfo]:
        """Values for the user, NaN where the status requires it, and the `SolveInfo` of the solve.

        Args:
            values: pytree of what the model found.
            *checks: (failed, status) pairs of what the model found wrong on its way, in any order.
            info: of the solver inside; its status is returned where no check fails, and does not change the values.
        """
        info = converged(jnp.zeros(())) if info is None else info
        known = self.good
        for failed, name in checks:
            known = known & ~failed if name in WITHOUT_VALUE else known
        # By `good`, which the values need as well: selected by the refusals XLA would store each of those conditions.
        # XLA evaluates a condition once for each of its readers, and rounds differently: at its edge `good` may be
        # false while no refusal holds. Such a case has no value, so it must not end as a success.
        refused = first_failure(*self.refused, otherwise=Status.NONFINITE)
        status = jnp.where(self.good, first_failure(*checks, otherwise=info.status), refused)
        values = jax.tree.map(lambda value: jnp.where(known, value, jnp.nan), values)
        return values, SolveInfo(status, info.steps, info.residual)

    def close_all(self, values: object, infos: SolveInfo, idle: Array | bool = False) -> tuple[PyTree, SolveInfo]:
        """`close` of a result of several solves: NaN unless all succeed; steps of all, largest residual.

        Args:
            values: floating results.
            infos: of the solves.
            idle: whether a success counts as UNLOADED.
        """
        state = worst(infos.status)
        ended = jnp.where(idle, int(Status.UNLOADED), int(Status.CONVERGED))
        state = jnp.where(succeeded(state), ended, state).astype(jnp.int32)
        whole = SolveInfo(state, jnp.sum(infos.steps), jnp.max(infos.residual))
        values, info = self.close(values, info=whole)
        fine = succeeded(info.status)
        return jax.tree.map(lambda value: jnp.where(fine, value, jnp.nan), values), info


def admit(inputs: object, harmless: object, *checks: Check, after: Gate | None = None) -> tuple[PyTree, Gate]:
    """The inputs with harmless numbers in the place of every case outside a model's domain, and its gate.

    Args:
        inputs: pytree of numbers.
        harmless: pytree of the same structure, or one number for all.
        *checks: (failed, status) pairs, each () or of the shape of a case.
        after: gate of inputs that were admitted before; a case that fails there fails here.
    """
    gate = Gate((*(after.refused if after else ()), *checks))
    good = gate.good
    if jax.tree_util.all_leaves([harmless]):
        harmless = jax.tree.map(lambda _: harmless, inputs)
    return jax.tree.map(lambda value, spare: jnp.where(good, value, spare), inputs, harmless), gate


def window(like: Array, power: float) -> tuple[float, float]:
    """Least and largest size of numbers whose powers 1/`power` neither vanish nor overflow.

    Args:
        like: any of them, for its dtype.
        power: such as 0.5, where squares are formed on the way.
    """
    limits = jnp.finfo(like.dtype)
    return float(limits.tiny) ** power, float(limits.max) ** power


def succeeded(status: Statuses) -> Statuses:
    """True where a status counts as success: CONVERGED and UNLOADED; an array of the library of the given one."""
    return (status == Status.CONVERGED) | (status == Status.UNLOADED)


def check(result: Result, max_failed_fraction: float = 0.0) -> Result:
    """Return `result`, or raise if too many of its cases failed; for use outside jit.

    Args:
        result: any solved result (a record with a field `info`), of one case or of a batch.
        max_failed_fraction: share of cases that may fail, 0 to 1.

    Raises:
        SolveError: names the reasons, their counts and the first failed case of each.
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
