"""Margins of units where a share of them must keep a limit, or all limits at once."""

import dataclasses

import numpy as np

from rvjax.tolerances.requirements.kinds import Requirement
from rvjax.tolerances.requirements.limits import Limits


@dataclasses.dataclass(frozen=True)
class Share:
    """Margins (n,) of units, derivatives (n,) of these to each response, and the share that must keep a limit."""

    margins: np.ndarray
    outward: dict[str, np.ndarray]
    target: float


def share_of(name: str, item: Limits, values: np.ndarray) -> Share:
    """Units of one limit, of which nan failed.

    Args:
        name: of the response.
        item: its limit.
        values: (n,) of the units.
    """
    assert isinstance(item, Requirement)
    outward = np.where(np.isnan(values), 0.0, item.outward(values))
    return Share(item.margins(values), {name: outward}, item.target)


def joint_share(
    items: dict[str, Limits], ways: dict[str, float], values: dict[str, np.ndarray], target: float
) -> Share:
    """Units that must keep all limits: the largest margin in parts of its way decides.

    Args:
        items: limits by name of the response.
        ways: by name.
        values: {response: (n,)}, nan where a unit failed.
        target: share of the units.
    """
    failed = np.any([np.isnan(values[n]) for n in items], axis=0)
    scaled = np.stack([item.margin(values[n]) / ways[n] for n, item in items.items()])
    leading = np.where(failed, -1, scaled.argmax(axis=0))
    pulls = {
        n: np.where(leading == i, item.outward(values[n]) / ways[n], 0.0) for i, (n, item) in enumerate(items.items())
    }
    return Share(np.where(failed, np.inf, scaled.max(axis=0)), pulls, target)
