"""Second stage of an RV reducer as four-bar linkages: part errors, clearance and load turn the output.

Two crankshafts, a cycloid disc (coupler) and the carrier (frame) form a parallelogram. Its
deviations turn the disc against the carrier: the transmission error. `solve_closure` treats one linkage,
`transmission_error` a reducer with any number of cranks and discs, `revolution` a whole crank turn and
`figures` its values.

Source: "original error" analysis of an RV-40E as a four-bar linkage (anonymous web article). Its
equations are unnumbered; here (S1) is the closure, (S2) its quadratic, (S4) the loaded crank length.
"""

from rvjax.four_bar.extremes import Figures
from rvjax.four_bar.linkage import Closure, LinkDeviations, solve_closure
from rvjax.four_bar.reducer import Revolution, TransmissionError, figures, revolution, transmission_error

__all__ = ["Closure", "Figures", "LinkDeviations", "Revolution", "TransmissionError", "figures", "revolution"]
__all__ += ["solve_closure", "transmission_error"]
