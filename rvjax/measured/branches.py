"""The two branches of a torque-angle loop, which a bench records in the order of time."""

import numpy as np

from rvjax.units import arcmin

CLIPPED = 0.03  # share of samples at the extreme torque, from which on a sensor has hit its end
GRID = 21  # torques of the midline of a loop


def branches(
    where: str, torque: np.ndarray, angle: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]:
    """Torques of a grid, midline, width, standard deviation of the midline, and whether the sensor was saturated.

    Args:
        where: of the loop, for messages.
        torque: in the order of time, N m.
        angle: of the same samples, rad.

    Raises:
        ValueError: too few samples, or one branch only.
    """
    span = np.ptp(torque)
    if len(torque) < 4 * GRID or span == 0:
        raise ValueError(f"{where} of {len(torque)} samples over {span:.4g} N m: needs {4 * GRID} samples, both ways")
    window = max(1, len(torque) // 100)  # the sign of the slope, not of the noise of the sensor
    ahead = np.clip(np.arange(len(torque)) + window, 0, len(torque) - 1)
    behind = np.clip(np.arange(len(torque)) - window, 0, len(torque) - 1)
    rising = torque[ahead] - torque[behind] > 0
    inside, clipped = np.isfinite(torque), False
    for extreme in (torque.max(), torque.min()):
        at_end = np.abs(torque - extreme) <= 1e-3 * span
        if at_end.mean() >= CLIPPED:
            inside, clipped = inside & ~at_end, True
    both = [inside & rising, inside & ~rising]
    if min(np.sum(branch) for branch in both) < 2 * GRID:
        raise ValueError(f"{where}: only one branch, or too few samples; the torque has to rise and to fall")
    low = max(np.min(torque[branch]) for branch in both)
    high = min(np.max(torque[branch]) for branch in both)
    half = (high - low) / (2 * GRID)
    grid = np.linspace(low + half, high - half, GRID)
    values = np.array([[_local(where, torque[b], angle[b], t, half) for t in grid] for b in both])
    up, down = values[0], values[1]
    return grid, (up[:, 0] + down[:, 0]) / 2, down[:, 0] - up[:, 0], np.hypot(up[:, 1], down[:, 1]) / 2, clipped


def _local(where: str, torque: np.ndarray, angle: np.ndarray, at: float, half: float) -> tuple[float, float]:
    """Value of a branch at one torque from a line through the samples about it, and its standard deviation."""
    near = np.abs(torque - at) <= half
    if np.sum(near) < 4:
        raise ValueError(f"{where}: {np.sum(near)} samples within {half:.4g} N m of {at:.4g} N m on a branch, needs 4")
    rows = np.stack([np.ones(int(np.sum(near))), (torque[near] - at) / half], axis=1)
    solution, *_ = np.linalg.lstsq(rows, angle[near], rcond=None)
    freedom = len(rows) - 2
    spread = np.sqrt(np.sum((angle[near] - rows @ solution) ** 2) / freedom)
    covariance = np.linalg.pinv(rows.T @ rows)
    return float(solution[0]), float(max(spread * np.sqrt(covariance[0, 0]), 1e-6 * arcmin))
