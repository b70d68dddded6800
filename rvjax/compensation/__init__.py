"""Compensation: correction of the transmission error of one measured unit. Independent of gears.

An error is a curve over one output turn, given by its orders: d(theta) = Re sum v_k exp(i k theta), and the output
is at theta_in/ratio + d.
"""

from rvjax.compensation.correction import Correction, Left, Residual, correction, phase_residual, predicted, residual
from rvjax.compensation.table import (
    FORMS as FORMS,
    Schedule,
    Table,
    export,
    exported as exported,
    read,
    schedule,
    table,
)

__all__ = ["Correction", "Left", "Residual", "Schedule", "Table", "correction", "export", "phase_residual"]
__all__ += ["predicted", "read", "residual", "schedule", "table"]
