"""rvjax: accuracy of precision reducers as pure, differentiable JAX functions.

Models (`four_bar` ...) turn a design and its manufacturing errors into a response; `tolerances` turns
part tolerances into the distribution of a response and a required yield into the cheapest tolerances.
"""

# ruff: noqa: F401  (type checkers read the imports below; all others load these names at first use)
import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rvjax import catalogue, plotting, units
    from rvjax.cycloidal import CycloidalErrors, CycloidalReducer, CycloidalStiffness, OutputPins
    from rvjax.designs import (
        BallBearing,
        Bearings,
        CamRollerReducer,
        Contact,
        CrankStage,
        CycloidStage,
        Damping,
        Friction,
        Inertia,
        InvoluteStage,
        MeshVariation,
        RollerBearing,
        RVReducer,
        Stiffness,
    )
    from rvjax.errors import CamRollerErrors, RVErrors
    from rvjax.records import Record
    from rvjax.status import SolveError, SolveInfo, Status, check

__version__ = "0.2.0"

# Homes of names that are loaded at first use, because importing JAX takes a second.
_HOMES = {
    "cycloidal": "CycloidalErrors CycloidalReducer CycloidalStiffness OutputPins",
    "designs": (
        "BallBearing Bearings CamRollerReducer Contact CrankStage CycloidStage Damping Friction Inertia InvoluteStage "
        "MeshVariation RVReducer RollerBearing Stiffness"
    ),
    "dynamics": (
        "Block Blocks DynamicError ErrorExcitation ErrorStatistics Floquet Lumped Modes Periodic "
        "Response SpeedSweep Static System"
    ),
    "errors": "CamRollerErrors RVErrors",
    "four_bar": "Closure LinkDeviations Revolution TransmissionError",
    "life": "BearingLife Duty RatedTorque Rating",
    "loaded": "Loaded Reading Torsion",
    "lost_motion": "LoopFigures LostMotion LostMotionTerms",
    "mesh_force": "ContactPressure CycleStatistics MeshForces ToothProfile",
    "records": "Record",
    "roots": "Root",
    "running": "BackDriving DragFit Hysteresis Joint Losses",
    "status": "SolveError SolveInfo Status check",
}
_MODULES = (
    "assembly catalogue compensation dynamics four_bar geometry identify levels life loaded lost_motion mesh_force "
    "models mounting plotting published roots running study tolerances units "
)
_LAZY = {name: home for home, names in _HOMES.items() for name in names.split()} | dict.fromkeys(_MODULES.split())

_GROUND = ("bearings", "cycloidal", "designs", "errors", "flank", "records", "status")  # submodules

__all__ = ["enable_x64", *sorted(_LAZY)]


def enable_x64() -> None:
    """Make float64 JAX's default; call it first. Importing rvjax changes no JAX setting."""
    import jax

    jax.config.update("jax_enable_x64", True)


def __getattr__(name: str) -> Any:
    if name not in (*_LAZY, *_GROUND):
        raise AttributeError(f"module 'rvjax' has no attribute {name!r}")
    home = _LAZY.get(name)
    if home is None:
        return importlib.import_module(f"rvjax.{name}")
    return getattr(importlib.import_module(f"rvjax.{home}"), name)


def __dir__() -> list[str]:
    """Names for completion: models, tools and their inputs; results list their own fields."""
    typed = (name for name, home in _LAZY.items() if home in (None, "cycloidal", "designs", "errors", "status"))
    return sorted(
        {"__version__", "enable_x64", "LinkDeviations", "Reading", *typed}
        - {"models", "mounting", "roots", "SolveInfo", "CycloidalStiffness", "OutputPins"}
        - {"Damping", "Inertia", "MeshVariation"}
    )
