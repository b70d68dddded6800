"""Errors of the parts of a reducer. Every field is a deviation from nominal and defaults to zero.

One physical error has one home: each model reads the fields it depends on, and the derivative of a
model to a field it does not read is exactly zero. The metadata of its field (`deviation`) describe an error
to the other layers: a new error is one field.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax.records import Design, PyTree, Record, Scalar, Shape, broadcast_fields, field, record, remind_of_precision

STAGES: dict[str, str] = {}
"""Stage of each part that errors belong to; of an RV reducer as in its design."""


def part(name: str, *, stage: str) -> str:
    """Declare a part of the reducer.

    Args:
        name: of the part.
        stage: that the part belongs to.
    """
    STAGES[name] = stage
    return name


SUN, PLANETS, GEARS = (part(name, stage="involute") for name in ("sun", "planets", "gears"))
DISCS, RING = (part(name, stage="cycloid") for name in ("discs", "ring"))
CRANKS, BEARINGS, CARRIER = (part(name, stage="cranks") for name in ("cranks", "bearings", "carrier"))
CAM, ROLLERS = (part(name, stage="rollers") for name in ("cam", "rollers"))


class Bound(NamedTuple):
    """Rule that derives an error without a place from one with a place."""

    placed: str  # name of the error with a place
    size: Callable[[jax.Array], jax.Array]  # its values -> the error without a place


def deviation(
    unit: str,
    meaning: str,
    *,
    part: str,
    read_by: tuple[str, ...] = (),
    of: str = "",
    shape: Shape = (),
    sign: str = "any",
    vector: str = "",
    placed: bool = False,
    bounds: Bound | None = None,
    carried_by: str = "",
    mirrored: tuple[int, ...] = (1,),
    breaks_pitch: bool = False,
    series: bool = False,
) -> Any:
    """Declare an error: a field that defaults to zero, with the metadata that other layers need.

    Args:
        unit: SI unit, "-" for none.
        meaning: one line.
        part: of the reducer, from `part`.
        read_by: models that read the field, such as "four_bar". A share of a stiffness is read by none: see
            `RVErrors.stiffened`.
        of: what it deviates from, by its path in the design; "" where that is no number of it.
        shape: names or numbers of axes; () is a scalar.
        sign: "positive", "nonnegative" or "any".
        vector: what its last axis is: "xy" in the frame of the housing, "polar" [radial, tangential], or "" (no
            displacement).
        placed: it has a place on its part, and only models with places read it.
        bounds: for an error without a place, the error with a place that it is a bound of.
        carried_by: "disc", "crank" or "carrier" where one part carries it from slot to slot.
        mirrored: factors on the last axis when a disc is turned over; not for "xy".
        breaks_pitch: with it, one turn of the cranks is not like the next.
        series: a Fourier series, which brings its own length.
    """
    about: dict[str, Any] = dict(read_by=read_by, vector=vector, placed=placed, bounds=bounds, carried_by=carried_by)
    about |= dict(mirrored=mirrored, breaks_pitch=breaks_pitch, series=series)
    return field(unit, meaning, shape=shape, default=0.0, sign=sign, of=of, part=part, **about)


def described(errors: PyTree, key: str) -> dict[str, PyTree]:
    """Metadata of the fields that have it, by field: `described(RVErrors, "placed")`.

    Args:
        errors: error record, or its class.
        key: argument of `deviation`.
    """
    return _described(errors if isinstance(errors, type) else type(errors), key)


@lru_cache(maxsize=256)
def _described(cls: type[Record], key: str) -> dict[str, PyTree]:
    return {f.name: f.metadata[key] for f in dataclasses.fields(cls) if f.metadata.get(key)}


def read_by(errors: PyTree, model: str) -> tuple[str, ...]:
    """Names of the errors that a model reads.

    Args:
        errors: error record, or its class.
        model: such as "four_bar".
    """
    return tuple(name for name, models in described(errors, "read_by").items() if model in models)


def placed_by(errors: PyTree, model: str) -> tuple[str, ...]:
    """Names of the errors with a place that a model reads, or has a bound for.

    Args:
        errors: error record, or its class.
        model: such as "lost_motion".
    """
    read = set(read_by(errors, model))
    read |= {bound.placed for name, bound in described(errors, "bounds").items() if name in read}
    return tuple(name for name in described(errors, "placed") if name in read)


class Errors(Record):
    """Base of the error records."""

    of_design: ClassVar[str]  # name of the class of designs whose parts deviate so

    def _check(self) -> None:
        """Plain numbers of microns become float32 wherever they are computed with, unless float64 is enabled."""
        values = [value for value in vars(self).values() if not isinstance(value, Record)]
        on_purpose = any(getattr(value, "dtype", None) == np.float32 for value in values)
        if not on_purpose and any(isinstance(value, (float, np.ndarray)) and np.any(value) for value in values):
            remind_of_precision()

    @classmethod
    def for_design(cls, design: Design, **errors: PyTree) -> Self:
        """Errors with full array shapes; a scalar for an array field is broadcast.

        Args:
            design: gives the counts of the shapes.
            **errors: fields by name; absent ones are zero, those with a place as a plain number.

        Raises:
            ValueError: unknown field, or a shape that does not fit the design.
        """
        own = getattr(design, "error_record", None)
        if not isinstance(own, type) or not (issubclass(cls, own) or issubclass(own, cls)):
            raise ValueError(
                f"{cls.__name__}.for_design: takes a design of kind {cls.of_design}, got {type(design).__name__}"
            )
        full = broadcast_fields(cls, design.counts, errors)
        return cls(**full | {name: 0.0 for name in described(cls, "placed") if name not in errors})


def _runout(centres: jax.Array) -> jax.Array:
    """Twice the largest length; the derivative at zero is zero."""
    square = jnp.max(jnp.sum(jnp.square(jnp.broadcast_to(centres, (*centres.shape[:-1], 2))), axis=-1))
    return 2 * jnp.where(square > 0, jnp.sqrt(jnp.where(square > 0, square, 1)), 0)


def _tangential(offsets: jax.Array) -> jax.Array:
    """Largest size of the second component."""
    return jnp.max(jnp.abs(offsets[..., 1] if offsets.ndim else offsets))


def _range(pitch: jax.Array) -> jax.Array:
    """Largest less smallest, of the worst disc."""
    return jnp.max(jnp.max(pitch, axis=-1) - jnp.min(pitch, axis=-1)) if pitch.ndim else 0 * pitch


Sprung = TypeVar("Sprung", bound=Design)


@record
class RVErrors(Errors):
    """Manufacturing errors of the parts of an RV reducer.

    Bore positions are [radial, tangential] in the frame of their crank, pin offsets in the frame of their pin, planet
    runouts in the frame of their planet at input angle 0: radial away from the main axis, tangential counter-clockwise.
    Pin 0 and eccentric 0 lie on the x axis at input angle 0. The errors from `support_clearance` on have a place;
    `rvjax.loaded` and, as excitation, `rvjax.dynamics` read them. `pin_position`, `disc_runout` and
    `disc_cumulative_pitch` are bounds without a place.

    A flank series holds [a, b] of a cos(h chi) + b sin(h chi), h = 1, 2, ..: excess material on the loaded flank. chi
    is the angle in the part at which it meets: of the planet in the sun, of the sun in a planet, of the eccentric in
    disc and ring; it counts from crank 0 (in a planet: from its own crank outwards) at input angle 0. The series brings
    its own length; 0.0 is none. `rvjax.dynamics` alone reads it.
    """

    of_design: ClassVar[str] = "RVReducer"

    crank_eccentricity: Scalar = deviation(
        "m",
        "eccentricity of each crank journal",
        shape=("discs", "cranks"),
        of="cycloid.eccentricity",
        part=CRANKS,
        read_by=("four_bar", "dynamics", "loaded", "life"),
        carried_by="crank",
    )
    crank_phase: Scalar = deviation(
        "rad",
        "angle of each crankshaft",
        shape=("cranks",),
        part=CRANKS,
        read_by=("four_bar", "dynamics", "loaded", "life"),
        carried_by="crank",
    )
    disc_bore: Scalar = deviation(
        "m",
        "position of the bores in the discs",
        shape=("discs", "cranks", 2),
        of="cranks.circle_radius",
        part=DISCS,
        read_by=("four_bar", "dynamics", "loaded", "life"),
        vector="polar",
        carried_by="disc",
        mirrored=(1, -1),
    )
    carrier_bore: Scalar = deviation(
        "m",
        "position of the bores in the carrier",
        shape=("cranks", 2),
        of="cranks.circle_radius",
        part=CARRIER,
        read_by=("four_bar", "dynamics", "loaded", "life"),
        vector="polar",
        carried_by="carrier",
    )
    bearing_clearance: Scalar = deviation(
        "m",
        "radial clearance of the crank bearings, half the diametral clearance",
        sign="nonnegative",
        part=BEARINGS,
        read_by=("four_bar", "lost_motion", "loaded", "life"),
    )
    eccentricity: Scalar = deviation(
        "m",
        "eccentricity of discs and cranks alike",
        of="cycloid.eccentricity",
        part=CRANKS,
        read_by=("four_bar", "lost_motion", "loaded", "life"),
    )
    pin_circle_radius: Scalar = deviation(
        "m",
        "radius of the pin circle; > 0 is clearance",
        of="cycloid.pin_circle_radius",
        part=RING,
        read_by=("lost_motion", "loaded", "life"),
    )
    pin_radius: Scalar = deviation(
        "m",
        "radius of the pins; < 0 is clearance",
        of="cycloid.pin_radius",
        part=RING,
        read_by=("lost_motion", "loaded", "life"),
    )
    pin_hole_clearance: Scalar = deviation(
        "m",
        "diametral clearance of the pins",
        sign="nonnegative",
        of="cycloid.pin_radius",
        part=RING,
        read_by=("lost_motion", "loaded", "life"),
    )
    pin_position: Scalar = deviation(
        "m",
        "circumferential position of the pins",
        part=RING,
        read_by=("lost_motion",),
        bounds=Bound("pin_offset", _tangential),
    )
    disc_runout: Scalar = deviation(
        "m",
        "radial runout of the disc teeth",
        part=DISCS,
        read_by=("lost_motion",),
        bounds=Bound("disc_centre", _runout),
    )
    disc_cumulative_pitch: Scalar = deviation(
        "m",
        "cumulative pitch error of the disc",
        part=DISCS,
        read_by=("lost_motion",),
        bounds=Bound("disc_pitch", _range),
    )
    equidistant_modification: Scalar = deviation(
        "m", "deviation of the equidistant modification", part=DISCS, read_by=("lost_motion", "loaded", "life")
    )
    shift_modification: Scalar = deviation(
        "m", "deviation of the shift modification", part=DISCS, read_by=("lost_motion", "loaded", "life")
    )
    base_tangent_upper: Scalar = deviation(
        "m",
        "upper deviation of the base tangent length; < 0 thins the tooth",
        part=GEARS,
        read_by=("lost_motion", "loaded", "life"),
    )
    base_tangent_lower: Scalar = deviation(
        "m",
        "lower deviation of the base tangent length; < 0 thins the tooth",
        part=GEARS,
        read_by=("lost_motion", "loaded", "life"),
    )
    support_clearance: Scalar = deviation(
        "m",
        "radial clearance of the cranks in the carrier",
        sign="nonnegative",
        part=BEARINGS,
        read_by=("loaded", "life"),
        placed=True,
    )
    pin_offset: Scalar = deviation(
        "m",
        "position of each pin in the housing",
        shape=("pins", 2),
        part=RING,
        read_by=("dynamics", "loaded", "life"),
        placed=True,
        vector="polar",
        breaks_pitch=True,
    )
    pin_radii: Scalar = deviation(
        "m",
        "radius of each pin, added to the common one",
        shape=("pins",),
        of="cycloid.pin_radius",
        part=RING,
        read_by=("dynamics", "loaded", "life"),
        placed=True,
        breaks_pitch=True,
    )
    ring_centre: Scalar = deviation(
        "m",
        "pin circle against the main bearings, housing x, y",
        shape=(2,),
        part=RING,
        read_by=("dynamics", "loaded", "life"),
        placed=True,
        vector="xy",
        breaks_pitch=True,
    )
    disc_centre: Scalar = deviation(
        "m",
        "teeth against bores, x, y at input angle 0",
        shape=("discs", 2),
        part=DISCS,
        read_by=("dynamics", "loaded", "life"),
        placed=True,
        vector="xy",
        carried_by="disc",
    )
    disc_pitch: Scalar = deviation(
        "m",
        "position of each tooth on its circle, counter-clockwise",
        shape=("discs", "teeth"),
        part=DISCS,
        read_by=("loaded", "life"),
        placed=True,
        carried_by="disc",
        mirrored=(-1,),
    )
    disc_profile: Scalar = deviation(
        "m",
        "material normal to the flank, [cosine, sine] of 0 to 4 times the angle of a lobe",
        shape=("discs", 5, 2),
        part=DISCS,
        read_by=("loaded", "life"),
        placed=True,
        carried_by="disc",
        mirrored=(1, -1),
    )
    sun_runout: Scalar = deviation(
        "m",
        "eccentricity of the sun teeth, x, y at input angle 0",
        shape=(2,),
        part=SUN,
        read_by=("dynamics", "loaded", "life"),
        placed=True,
        vector="xy",
        breaks_pitch=True,
    )
    planet_runout: Scalar = deviation(
        "m",
        "eccentricity of the planet teeth",
        shape=("cranks", 2),
        part=PLANETS,
        read_by=("dynamics", "loaded", "life"),
        placed=True,
        vector="polar",
        carried_by="crank",
    )
    sun_planet_stiffness: Scalar = deviation(
        "-", "share by which all meshes of sun and planets are stiffer", part=GEARS, of="stiffness.sun_planet_mesh"
    )
    disc_pin_stiffness: Scalar = deviation(
        "-", "share by which all meshes of discs and pins are stiffer", part=RING, of="stiffness.disc_pin_mesh"
    )
    turning_arm_stiffness: Scalar = deviation(
        "-", "share by which all bearings in the discs are stiffer", part=BEARINGS, of="stiffness.turning_arm_bearing"
    )
    support_stiffness: Scalar = deviation(
        "-", "share by which all bearings in the carrier are stiffer", part=BEARINGS, of="stiffness.support_bearing"
    )
    sun_flank: Scalar = deviation(
        "m",
        "flanks of the sun; > 0 is material",
        shape=("sun_orders", 2),
        part=SUN,
        read_by=("dynamics",),
        series=True,
    )
    planet_flank: Scalar = deviation(
        "m",
        "flanks of each planet; > 0 is material",
        shape=("cranks", "planet_orders", 2),
        part=PLANETS,
        read_by=("dynamics",),
        series=True,
    )
    disc_flank: Scalar = deviation(
        "m",
        "flank of each disc; > 0 is material",
        shape=("discs", "disc_orders", 2),
        part=DISCS,
        read_by=("dynamics",),
        series=True,
    )
    ring_flank: Scalar = deviation(
        "m",
        "pins of the ring; > 0 is material",
        shape=("ring_orders", 2),
        part=RING,
        read_by=("dynamics",),
        series=True,
    )

    def stiffened(self, design: Sprung) -> Sprung:
        """The design with the stiffness of this unit, for the models that read it."""
        springs: Any = getattr(design, "stiffness", None)
        if springs is None:
            return design
        paths = {name: path.split(".") for name, path in described(self, "of").items()}
        shares = {path[1]: getattr(self, name) for name, path in paths.items() if path[0] == "stiffness"}
        own = {name: getattr(springs, name) * (1 + share) for name, share in shares.items()}
        return design.replace(stiffness=springs.replace(**own))

    def bounded(self, names: Iterable[str]) -> Self:
        """The same errors with some bounds without a place as what they bound: of one unit, one home.

        Args:
            names: errors with `bounds`. `disc_runout` becomes twice the largest length of a `disc_centre`,
                `pin_position` the largest tangential `pin_offset`, `disc_cumulative_pitch` the largest range of a
                `disc_pitch`.
        """
        bounds: Mapping[str, Bound] = described(self, "bounds")
        own = {name: bounds[name] for name in names}
        return self.replace(**{n: bound.size(jnp.asarray(getattr(self, bound.placed))) for n, bound in own.items()})


@record
class CamRollerErrors(Errors):
    """Manufacturing errors of an oscillatory roller stage; > 0 is extra material or throw, that is interference."""

    of_design: ClassVar[str] = "CamRollerReducer"

    cam_radius: Scalar = deviation("m", "radius of the disc cam", of="cam_radius", part=CAM, read_by=("mesh_force",))
    eccentricity: Scalar = deviation(
        "m", "eccentricity of the cam (installation)", of="eccentricity", part=CAM, read_by=("mesh_force",)
    )
    roller_radius: Scalar = deviation(
        "m",
        "radius of the rollers, one number or one per roller",
        shape=("rollers",),
        of="roller_radius",
        part=ROLLERS,
        read_by=("mesh_force",),
    )
