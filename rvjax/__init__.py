"""rvjax: accuracy of precision reducers as pure, differentiable JAX functions.

Models (`four_bar` ...) turn a design and its manufacturing errors into a response; `tolerances` turns
part tolerances into the distribution of a response and a required yield into the cheapest tolerances.
"""

import importlib
from typing import Any

from rvjax import catalogue, units
from rvjax.designs import (
    CamRollerReducer,
    Contact,
    CrankStage,
    CycloidStage,
    Damping,
    Inertia,
    InvoluteStage,
    MeshVariation,
    RVReducer,
    Stiffness,
)
from rvjax.errors import CamRollerErrors, RVErrors
from rvjax.records import Record
from rvjax.status import SolveError, SolveInfo, Status, check

__version__ = "0.1.0"

# Where a name lives that is loaded when first asked for; None: the name is a submodule.
_LAZY = {
    "Block": "dynamics",
    "Blocks": "dynamics",
    "Closure": "four_bar",
    "ContactPressure": "mesh_force",
    "CycleStatistics": "mesh_force",
    "EnergyShares": "dynamics",
    "Floquet": "dynamics",
    "LinkDeviations": "four_bar",
    "Loaded": "loaded",
    "LoopFigures": "lost_motion",
    "LostMotion": "lost_motion",
    "LostMotionTerms": "lost_motion",
    "Lumped": "dynamics",
    "MeshForces": "mesh_force",
    "Modes": "dynamics",
    "Periodic": "dynamics",
    "Response": "dynamics",
    "Revolution": "four_bar",
    "Root": "roots",
    "Static": "dynamics",
    "System": "dynamics",
    "ToothProfile": "mesh_force",
    "Torsion": "loaded",
    "TransmissionError": "four_bar",
    "dynamics": None,
    "four_bar": None,
    "levels": None,
    "loaded": None,
    "lost_motion": None,
    "mesh_force": None,
    "models": None,
    "plotting": None,
    "published": None,
    "roots": None,
    "study": None,
    "tolerances": None,
}

__all__ = [
    "CamRollerErrors",
    "CamRollerReducer",
    "Contact",
    "CrankStage",
    "CycloidStage",
    "Damping",
    "Inertia",
    "InvoluteStage",
    "MeshVariation",
    "RVErrors",
    "RVReducer",
    "Record",
    "SolveError",
    "SolveInfo",
    "Status",
    "Stiffness",
    "catalogue",
    "check",
    "enable_x64",
    "units",
    *sorted(_LAZY),
]


def enable_x64() -> None:
    """Make float64 JAX's default; call it first. Importing rvjax changes no JAX setting."""
    import jax

    jax.config.update("jax_enable_x64", True)


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module 'rvjax' has no attribute {name!r}")
    home = _LAZY[name]
    if home is None:
        return importlib.import_module(f"rvjax.{name}")
    return getattr(importlib.import_module(f"rvjax.{home}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
