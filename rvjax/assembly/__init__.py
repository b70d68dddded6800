"""Assembly: best combinations and angular positions of measured parts. Independent of gears.

Parts + measurement uncertainty --believed--> what is known --plan--> build list --fresh draws--> what it gains
"""

from rvjax.assembly.belief import believed
from rvjax.assembly.costs import Machine as Machine
from rvjax.assembly.opening import Opening, opening
from rvjax.assembly.parts import Kind, Part
from rvjax.assembly.parts import known as known
from rvjax.assembly.plan import OBJECTIVES as OBJECTIVES
from rvjax.assembly.plan import Plan, plan
from rvjax.assembly.plan import draw as draw
from rvjax.assembly.plan import supply_of as supply_of

__all__ = ["Kind", "Opening", "Part", "Plan", "believed", "opening", "plan"]
