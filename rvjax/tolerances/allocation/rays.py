"""Looks along rays: where derivatives of units mislead, values of units take their place.

Where units fail, or a response moves in steps, derivatives of units do not give the slope of a limit. Along a ray from
zero errors every unit leaves its limits at its own factor on all half-widths. The factor at which a limit fails is
continuous in the decisions for any response, and its differences are slopes. They cost some dozen samples where
derivatives cost one, so only quick units are looked at so.
"""

import dataclasses

import numpy as np

from rvjax.tolerances.allocation.constraints import Constraints
from rvjax.tolerances.allocation.look import FAILED, Look

_INWARD, _OUTWARD = 5.0, 0.7  # reach of a ray, logarithm of the factor
_IDLE = 0.5  # with a larger factor than this, its logarithm, a limit does not bind
_STEP, _PART = 0.15, 0.05  # of differences, logarithm of a half-width or part of a range: several units cross
_DOUBLED = 4  # times: a part by which a limit is moved for its price, until that counts on both sides
_FINE, _COARSE = 1e-3, 3e-3  # accuracy of a place on a ray and of a difference


class Rays:
    """Looks at the constraints of a problem along rays."""

    def __init__(self, constraints: Constraints) -> None:
        self._constraints, self._first = constraints, len(constraints.decisions.fields)
        self._shares = np.array([row.share or row.name == FAILED for row in constraints.rows], bool)
        most = constraints.most_failed
        sure = 0.0 if most is None else constraints.problem.shown(1 - most, constraints.problem.run.samples)
        self._rejects = np.where([row.share for row in constraints.rows], 0.0, sure)
        """Failed units (c,) that a certificate allows; 0 for limits on shares."""

    def look(self, x: np.ndarray) -> Look:
        """Cost and used ways at a vector, those of shares along the ray."""
        plain = self._constraints.look(x)
        ends = np.full(len(plain.used), _INWARD), np.full(len(plain.used), _OUTWARD)
        room = self._room(x, -ends[0], ends[1], _FINE)
        slopes = np.stack([self._difference(x, room, j) for j in range(len(x))], axis=1)
        factors = np.exp(-room)
        return dataclasses.replace(
            plain,
            used=np.where(self._shares, factors, plain.used),
            jacobian=np.where(self._shares[:, None], factors[:, None] * slopes, plain.jacobian),
        )

    def ways(self, x: np.ndarray) -> np.ndarray:
        """Move of each limit (c,) for a used way, by differences; a limit that nothing moves has an endless one.

        Args:
            x: vector of decisions.
        """
        constraints, rows = self._constraints, self._constraints.rows
        here = self.look(x).used
        rates, known = np.zeros(len(rows)), np.zeros(len(rows), bool)
        for part in _PART * 2.0 ** np.arange(_DOUBLED):
            moves, used = part * constraints.ways, []
            for sign in (-1.0, 1.0):
                constraints.rows = [
                    dataclasses.replace(row, item=row.item.widened(sign * by)) if row.share and row.item else row
                    for row, by in zip(rows, moves)
                ]
                used.append(self.look(x).used)
            constraints.rows = rows
            both = (used[0] != here) & (used[1] != here)  # in steps a limit just above one counts on one side alone
            rates = np.where(known | ((rates != 0) & ~both), rates, (used[0] - used[1]) / (2 * moves))
            known |= both
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.where(self._shares, rates, 1 / constraints.ways))

    def _difference(self, x: np.ndarray, room: np.ndarray, j: int) -> np.ndarray:
        """-d log(factor)/d x_j of each limit that may bind."""
        step = _STEP if j < self._first else _PART
        open_ = np.where(room < _IDLE, _STEP, 0.0)
        found = []
        for sign in (1.0, -1.0):
            moved = x.copy()
            moved[j] = np.clip(
                x[j] + sign * step, -np.inf if j < self._first else 0.0, np.inf if j < self._first else 1.0
            )
            near, far = (0.5, 1.25) if j < self._first else (3.0, 3.0)  # a wider field takes no more than it grows
            low, high = (room - far * open_, room + near * open_)
            low, high = (low, high) if sign > 0 or j >= self._first else (room - near * open_, room + far * open_)
            found.append((self._room(moved, low, high, _COARSE), moved[j]))
        return -(found[0][0] - found[1][0]) / (found[0][1] - found[1][1])

    def _room(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, known: float) -> np.ndarray:
        """Logarithm of the factor at which each limit (c,) fails, by bisection; every sample serves all limits."""
        low, high = np.where(self._shares, low, 0.0), np.where(self._shares, high, 0.0)
        while (high - low).max(initial=0.0) > known:
            k = int(np.argmax(high - low))
            at = (low[k] + high[k]) / 2
            most = np.where(self._rejects > 0, self._rejects, self._constraints.rejects)
            met = self._beyond(x, float(np.exp(at))) <= most
            low = np.where(met, np.clip(at, low, high), low)
            high = np.where(met, high, np.clip(at, low, high))
        return (low + high) / 2

    def _beyond(self, x: np.ndarray, scale: float) -> np.ndarray:
        """Share of units (c,) beyond each limit with `scale` times the half-widths; 0 where no share is limited."""
        constraints, decisions = self._constraints, self._constraints.decisions
        widths = dict(zip(decisions.fields, map(float, scale * decisions.half_widths(x))))
        population = decisions.population(x).with_half_widths(widths)
        values = constraints.units.values(population, constraints.tails.z)
        found, weights = np.zeros(len(constraints.rows)), constraints.tails.weights
        for k, row in enumerate(constraints.rows):
            if row.share:
                found[k] = float(weights[constraints.margins(k, values)[0] > 0].sum() / weights.sum())
            elif row.item is None:  # of failed units
                found[k] = float(np.any([np.isnan(own) for own in values.values()], axis=0).mean())
        return found
