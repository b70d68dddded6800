"""Errors of the parts of a reducer. Every field is a deviation from nominal and defaults to zero.

One physical error has one home: each model reads the fields it depends on, and the derivative of a
model to a field it does not read is exactly zero. The metadata of its field (`deviation`) describe an error
to the other layers: a new error is one field. A new kind of reducer has a record that derives from `Errors`.
"""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache, partial
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from rvjax._jax.checks import remind_of_precision
from rvjax.records import Design, PyTree, Record, Scalar, Shape, broadcast_fields, field, record

Sprung = TypeVar("Sprung", bound=Design)

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


class Bound(NamedTuple):
    """Rule that derives an error without a place from one with a place."""

    placed: str  # name of the error with a place
    size: Callable[[jax.Array], jax.Array]  # its values -> the error without a place


def deviation(
    unit: str,
    meaning: str,
    part: str,
    read_by: tuple[str, ...] = (),
    *,
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
            `Errors.stiffened`.
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


length = partial(deviation, "m")
"""An error in m."""
placed = partial(deviation, "m", placed=True)
"""An error in m that has a place."""
centre = partial(placed, shape=(2,), vector="xy")
"""An eccentricity of one part in m, x and y."""


def share(more: str, part: str, read_by: tuple[str, ...] = (), *, of: str = "") -> Any:
    """Declare a relative error.

    Args:
        more: what becomes larger by it.
        part: as in `deviation`.
        read_by: as in `deviation`.
        of: as in `deviation`.
    """
    return deviation("-", f"share by which {more}", part, read_by, of=of)


def described(errors: object, key: str) -> dict[str, PyTree]:
    """Metadata of the fields that have it, by field: `described(RVErrors, "placed")`.

    Args:
        errors: error record, or its class.
        key: argument of `deviation`.
    """
    return _described(errors if isinstance(errors, type) else type(errors), key)


@lru_cache(maxsize=256)
def _described(cls: type[Record], key: str) -> dict[str, object]:
    return {f.name: f.metadata[key] for f in dataclasses.fields(cls) if f.metadata.get(key)}


def read_by(errors: object, model: str) -> tuple[str, ...]:
    """Names of the errors that a model reads.

    Args:
        errors: error record, or its class.
        model: such as "four_bar".
    """
    return tuple(name for name, models in described(errors, "read_by").items() if model in models)


def placed_by(errors: object, model: str) -> tuple[str, ...]:
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
    def for_design(cls, design: Design, **errors: object) -> Self:
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

    def bounded(self, names: Iterable[str]) -> Self:
        """The same errors with some bounds without a place as what they bound: of one unit, one home.

        Args:
            names: errors with `bounds`, such as `disc_runout`: twice the largest length of a `disc_centre`.
        """
        bounds: Mapping[str, Bound] = described(self, "bounds")
        own = {name: bounds[name] for name in names}
        return self.replace(**{n: bound.size(jnp.asarray(getattr(self, bound.placed))) for n, bound in own.items()})

    def stiffened(self, design: Sprung) -> Sprung:
        """The design with the stiffness of this unit, for the models that read it."""
        springs: Any = getattr(design, "stiffness", None)
        if springs is None:
            return design
        paths = {name: path.split(".") for name, path in described(self, "of").items()}
        shares = {path[1]: getattr(self, name) for name, path in paths.items() if path[0] == "stiffness"}
        own = {name: getattr(springs, name) * (1 + share) for name, share in shares.items()}
        return design.replace(stiffness=springs.replace(**own))


SUN, PLANETS, GEARS = (part(name, stage="involute") for name in ("sun", "planets", "gears"))
DISCS, RING = (part(name, stage="cycloid") for name in ("discs", "ring"))
CRANKS, BEARINGS, CARRIER = (part(name, stage="cranks") for name in ("cranks", "bearings", "carrier"))
CAM, ROLLERS = (part(name, stage="rollers") for name in ("cam", "rollers"))

LOADED = ("loaded", "life", "running")  # models that read an error
RUNNING = ("running",)
LINKS = ("four_bar", "dynamics", *LOADED)
CLEARANCES = ("lost_motion", *LOADED)
FOUR_BAR = ("four_bar", *CLEARANCES)
EXCITATION = ("dynamics", *LOADED)

# Errors of one part, whose declarations have much in common.
_bound = partial(length, read_by=("lost_motion",))
_bore = partial(length, read_by=LINKS, of="cranks.circle_radius", vector="polar")
_of_disc = partial(placed, part=DISCS, read_by=LOADED, carried_by="disc")
_tooth = partial(length, part=GEARS, read_by=CLEARANCES)
_of_ring = partial(placed, part=RING, read_by=EXCITATION, breaks_pitch=True)
_series = partial(length, read_by=("dynamics",), series=True)


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

    crank_eccentricity: Scalar = length(
        "eccentricity of each crank journal",
        CRANKS,
        LINKS,
        shape=("discs", "cranks"),
        of="cycloid.eccentricity",
        carried_by="crank",
    )
    crank_phase: Scalar = deviation(
        "rad", "angle of each crankshaft", CRANKS, LINKS, shape=("cranks",), carried_by="crank"
    )
    disc_bore: Scalar = _bore(
        "position of the bores in the discs", DISCS, shape=("discs", "cranks", 2), carried_by="disc", mirrored=(1, -1)
    )
    carrier_bore: Scalar = _bore(
        "position of the bores in the carrier", CARRIER, shape=("cranks", 2), carried_by="carrier"
    )
    bearing_clearance: Scalar = length(
        "radial clearance of the crank bearings, half the diametral clearance", BEARINGS, FOUR_BAR, sign="nonnegative"
    )
    eccentricity: Scalar = length("eccentricity of discs and cranks alike", CRANKS, FOUR_BAR, of="cycloid.eccentricity")
    pin_circle_radius: Scalar = length(
        "radius of the pin circle; > 0 is clearance", RING, CLEARANCES, of="cycloid.pin_circle_radius"
    )
    pin_radius: Scalar = length("radius of the pins; < 0 is clearance", RING, CLEARANCES, of="cycloid.pin_radius")
    pin_hole_clearance: Scalar = length(
        "diametral clearance of the pins", RING, CLEARANCES, sign="nonnegative", of="cycloid.pin_radius"
    )
    pin_position: Scalar = _bound("circumferential position of the pins", RING, bounds=Bound("pin_offset", _tangential))
    disc_runout: Scalar = _bound("radial runout of the disc teeth", DISCS, bounds=Bound("disc_centre", _runout))
    disc_cumulative_pitch: Scalar = _bound(
        "cumulative pitch error of the disc", DISCS, bounds=Bound("disc_pitch", _range)
    )
    equidistant_modification: Scalar = length("deviation of the equidistant modification", DISCS, CLEARANCES)
    shift_modification: Scalar = length("deviation of the shift modification", DISCS, CLEARANCES)
    base_tangent_upper: Scalar = _tooth("upper deviation of the base tangent length; < 0 thins the tooth")
    base_tangent_lower: Scalar = _tooth("lower deviation of the base tangent length; < 0 thins the tooth")
    support_clearance: Scalar = placed(
        "radial clearance of the cranks in the carrier", BEARINGS, LOADED, sign="nonnegative"
    )
    pin_offset: Scalar = _of_ring("position of each pin in the housing", shape=("pins", 2), vector="polar")
    pin_radii: Scalar = _of_ring(
        "radius of each pin, added to the common one", shape=("pins",), of="cycloid.pin_radius"
    )
    ring_centre: Scalar = _of_ring("pin circle against the main bearings, housing x, y", shape=(2,), vector="xy")
    disc_centre: Scalar = _of_disc(
        "teeth against bores, x, y at input angle 0", read_by=EXCITATION, shape=("discs", 2), vector="xy"
    )
    disc_pitch: Scalar = _of_disc(
        "position of each tooth on its circle, counter-clockwise", shape=("discs", "teeth"), mirrored=(-1,)
    )
    disc_profile: Scalar = _of_disc(
        "material normal to the flank, [cosine, sine] of 0 to 4 times the angle of a lobe",
        shape=("discs", 5, 2),
        mirrored=(1, -1),
    )
    sun_runout: Scalar = centre(
        "eccentricity of the sun teeth, x, y at input angle 0", SUN, EXCITATION, breaks_pitch=True
    )
    planet_runout: Scalar = placed(
        "eccentricity of the planet teeth", PLANETS, EXCITATION, shape=("cranks", 2), vector="polar", carried_by="crank"
    )
    sun_planet_stiffness: Scalar = share(
        "all meshes of sun and planets are stiffer", GEARS, of="stiffness.sun_planet_mesh"
    )
    disc_pin_stiffness: Scalar = share("all meshes of discs and pins are stiffer", RING, of="stiffness.disc_pin_mesh")
    turning_arm_stiffness: Scalar = share(
        "all bearings in the discs are stiffer", BEARINGS, of="stiffness.turning_arm_bearing"
    )
    support_stiffness: Scalar = share(
        "all bearings in the carrier are stiffer", BEARINGS, of="stiffness.support_bearing"
    )
    ring_pin_friction: Scalar = share("the friction of ring pins is larger", RING, RUNNING)
    arm_bearing_friction: Scalar = share("the friction of the bearings in the discs is larger", BEARINGS, RUNNING)
    support_bearing_friction: Scalar = share("the friction of the bearings in the carrier is larger", BEARINGS, RUNNING)
    gear_mesh_friction: Scalar = share("the loss of the meshes of sun and planets is larger", GEARS, RUNNING)
    drag_friction: Scalar = share("drags, viscous drags and moments of unloaded bearings are larger", BEARINGS, RUNNING)
    sun_flank: Scalar = _series("flanks of the sun; > 0 is material", SUN, shape=("sun_orders", 2))
    planet_flank: Scalar = _series(
        "flanks of each planet; > 0 is material", PLANETS, shape=("cranks", "planet_orders", 2)
    )
    disc_flank: Scalar = _series("flank of each disc; > 0 is material", DISCS, shape=("discs", "disc_orders", 2))
    ring_flank: Scalar = _series("pins of the ring; > 0 is material", RING, shape=("ring_orders", 2))


@record
class CamRollerErrors(Errors):
    """Manufacturing errors of an oscillatory roller stage; > 0 is extra material or throw, that is interference."""

    of_design: ClassVar[str] = "CamRollerReducer"

    cam_radius: Scalar = length("radius of the disc cam", CAM, ("mesh_force",), of="cam_radius")
    eccentricity: Scalar = length("eccentricity of the cam (installation)", CAM, ("mesh_force",), of="eccentricity")
    roller_radius: Scalar = length(
        "radius of the rollers, one number or one per roller",
        ROLLERS,
        ("mesh_force",),
        shape=("rollers",),
        of="roller_radius",
    )
