"""Assembly: best combinations and angular positions of measured parts. Independent of gears.

Parts + measurement uncertainty --believed--> what is known --plan--> build list --fresh draws--> what it gains
"""

from rvjax.assembly.belief import believed, draw as draw, known as known
from rvjax.assembly.costs import Machine as Machine, UnitResponse as UnitResponse
from rvjax.assembly.opening import Opening, opening
from rvjax.assembly.parts import Kind, Outlier, Part, UnusualPart, outliers
from rvjax.assembly.plan import OBJECTIVES as OBJECTIVES, Plan, plan
from rvjax.assembly.supply import supply_of as supply_of

__all__ = ["Kind", "Opening", "Outlier", "Part", "Plan", "UnusualPart", "believed", "opening", "outliers", "plan"]
