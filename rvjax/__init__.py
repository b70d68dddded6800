"""rvjax: accuracy of precision reducers as pure, differentiable JAX functions.

Models (`four_bar` ...) turn a design and its manufacturing errors into a response; `tolerances` turns
part tolerances into the distribution of a response and a required yield into the cheapest tolerances.
"""

# ruff: noqa: F401  (type checkers read the imports below; all others get these names when they ask)
import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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

# Where a name lives that is loaded when first asked for, for JAX takes a second; None: the name is a submodule.
_LAZY = {
    "Block": "dynamics",
    "Blocks": "dynamics",
    "CamRollerErrors": "errors",
    "CamRollerReducer": "designs",
    "Closure": "four_bar",
    "Contact": "designs",
    "ContactPressure": "mesh_force",
    "CrankStage": "designs",
    "CycleStatistics": "mesh_force",
    "CycloidStage": "designs",
    "Damping": "designs",
    "DynamicError": "dynamics",
    "EnergyShares": "dynamics",
    "ErrorExcitation": "dynamics",
    "ErrorStatistics": "dynamics",
    "Floquet": "dynamics",
    "Inertia": "designs",
    "InvoluteStage": "designs",
    "LinkDeviations": "four_bar",
    "Loaded": "loaded",
    "LoopFigures": "lost_motion",
    "LostMotion": "lost_motion",
    "LostMotionTerms": "lost_motion",
    "Lumped": "dynamics",
    "MeshForces": "mesh_force",
    "MeshVariation": "designs",
    "Modes": "dynamics",
    "Periodic": "dynamics",
    "RVErrors": "errors",
    "RVReducer": "designs",
    "Record": "records",
    "Response": "dynamics",
    "Revolution": "four_bar",
    "Root": "roots",
    "SolveError": "status",
    "SolveInfo": "status",
    "SpeedSweep": "dynamics",
    "Static": "dynamics",
    "Status": "status",
    "Stiffness": "designs",
    "System": "dynamics",
    "ToothProfile": "mesh_force",
    "Torsion": "loaded",
    "TransmissionError": "four_bar",
    "check": "status",
    "assembly": None,
    "catalogue": None,
    "compensation": None,
    "dynamics": None,
    "four_bar": None,
    "identify": None,
    "levels": None,
    "loaded": None,
    "lost_motion": None,
    "mesh_force": None,
    "models": None,
    "mounting": None,
    "plotting": None,
    "published": None,
    "roots": None,
    "study": None,
    "tolerances": None,
    "units": None,
}

_GROUND = ("designs", "errors", "records", "status")  # submodules whose names are all above

__all__ = ["enable_x64", *sorted(_LAZY)]


def enable_x64() -> None:
    """Make float64 JAX's default; call it first. Importing rvjax changes no JAX setting."""
    import jax

    jax.config.update("jax_enable_x64", True)


def __getattr__(name: str) -> Any:
    if name not in _LAZY and name not in _GROUND:
        raise AttributeError(f"module 'rvjax' has no attribute {name!r}")
    home = _LAZY.get(name)
    if home is None:
        return importlib.import_module(f"rvjax.{name}")
    return getattr(importlib.import_module(f"rvjax.{home}"), name)


def __dir__() -> list[str]:
    """What a person types: models and tools, and what goes into them; what comes out of them shows itself."""
    typed = (name for name, home in _LAZY.items() if home in (None, "designs", "errors", "status"))
    return sorted(
        {"__version__", "enable_x64", "LinkDeviations", *typed} - {"models", "mounting", "roots", "SolveInfo"}
    )
