"""Orders of a measured curve that are more than noise."""

import numpy as np

from rvjax.identify import Orders


def significant(found: Orders, chance: float = 0.001) -> np.ndarray:
    """Places of the orders that noise alone would not show, with this chance that any of them is noise (s,).

    |value|^2/(2 sd^2) of pure noise is exponential; k orders pass ln(k/chance) with that chance at most.
    """
    level = np.log(max(len(found.order), 1) / chance)
    return np.flatnonzero(np.abs(found.value) ** 2 > 2 * found.sd**2 * level)
