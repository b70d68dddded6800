"""Scaling laws of RV reducers (`scaling.toml`), base circles of the gears, and the shortening coefficient."""

import tomllib
from collections.abc import Collection, Mapping
from importlib import resources

import jax.numpy as jnp

from rvjax.designs import RVReducer
from rvjax.records import PyTree, Scalar
from rvjax.study.kinds.following import Following, Law, number_at

_FILE: dict[str, PyTree] = tomllib.loads((resources.files("rvjax.study") / "scaling.toml").read_text("utf-8"))
ANGLE = "involute.pressure_angle"
BASE_RADII = ("involute.sun_base_radius", "involute.planet_base_radius")
SHORTENING = "cycloid.shortening"
PROFILE = ("cycloid.eccentricity", "cycloid.pin_circle_radius")  # the shortening coefficient follows

LAWS = tuple(
    Law(
        entry["name"],
        tuple(entry["numbers"]),
        {_FILE["numbers"][key]: float(power) for key, power in entry["follows"].items()},
        (float(entry["interval"][0]), float(entry["interval"][1])),
        entry["source"],
        entry.get("whole", False),
        entry.get("exact", False),
    )
    for entry in _FILE["law"]
)
"""Ordered: a number that follows comes before the numbers that follow it."""
NAMES: dict[str, str] = {path: name for name, path in _FILE["numbers"].items()}
"""Short names of the numbers that scaling laws read, by their path."""
SIZES: tuple[dict[str, PyTree], ...] = tuple(_FILE["tolerance"])
"""Sizes that tolerances belong to."""

GEARS = next(law for law in LAWS if law.exact)
AXIAL = next(law for law in LAWS if "bearings.disc_position" in law.numbers)  # discs of another width have other places


def _others(
    design: RVReducer, values: Mapping[str, Scalar], new: Mapping[str, PyTree], stands: Collection[str]
) -> dict[str, PyTree]:
    """The derived K1, and base circles of gears with another pressure angle."""
    found: dict[str, PyTree] = {SHORTENING: None} if set(PROFILE) & set(values) and SHORTENING not in stands else {}
    if ANGLE in values:
        ratio = jnp.cos(values[ANGLE]) / jnp.cos(design.involute.pressure_angle)
        for path in (path for path in BASE_RADII if path not in stands):
            found[path] = (new[path] if path in new else number_at(design, path)) * ratio
    return found


FOLLOWING = Following(
    LAWS,
    _others,
    bound={
        **dict.fromkeys(GEARS.follows, GEARS.numbers),
        **dict.fromkeys(AXIAL.follows, AXIAL.numbers),
        ANGLE: BASE_RADII,
        **dict.fromkeys(PROFILE, (SHORTENING,)),
    },
    instead={
        **dict.fromkeys(GEARS.numbers, "involute.module; vary that one"),
        SHORTENING: "eccentricity and pin circle radius; vary these",
    },
)
