"""New studies of single-stage drives: clearances, tolerances, torque and limits follow size, process and material.

`processes.toml` has the processes and materials with their sources.
"""

import math
import re
import tomllib
from importlib import resources

import numpy as np

from rvjax.catalogue import ASSUMED, BASES
from rvjax.cycloidal import CycloidalReducer
from rvjax.population import tolerance_unit
from rvjax.records import PyTree
from rvjax.study.kinds.kind import Assumed, Choices, Known, Numbers, Start
from rvjax.study.kinds.scaling import number_at, rewritten, scaled_line, stated, with_torque
from rvjax.study.values import in_unit
from rvjax.units import arcmin, parse

RATED = {"cycloidal-15": 5.0, "cycloidal-17": 8.8, "cycloidal-29": 116.0}
"""Rated torque, N m."""
OWN = {
    "cycloidal-15": ("printed", "polymer"),
    "cycloidal-17": ("milled", "aluminium"),
    "cycloidal-29": ("ground", "hardened steel"),
}
"""Usual process and material of the known drives."""
EXAMPLE = "cycloidal-17"  # its study has the tables of new ones
RING, FLANK, HOLE = "cycloid.pin_circle_radius", "cycloid.equidistant_modification", "output.hole_clearance"
DISCS = "cycloid.disc_count"
MODULUS, POISSON, SEAT = "contact.young_modulus", "contact.poisson_ratio", "stiffness.eccentric_bearing"
WIDTH = "contact.face_width"
PINS = ("contact.pin_young_modulus", "contact.pin_poisson_ratio")
PARTS = ("cycloid", "output", "stiffness", "contact", "bearings", "friction")
NEEDED = (
    "cycloid.disc_teeth", "cycloid.eccentricity", RING, "cycloid.pin_radius", "output.count", "output.circle_radius",
    "output.pin_radius",
)  # fmt: skip
"""Numbers that a drawing must give."""
SIZES = {  # key of a process, and the radius that the error grows with
    "equidistant_modification": ("flank", RING), "pin_offset": ("position", RING), "throw": ("throw", RING),
    "hole_position": ("position", "output.circle_radius"), "output_pin_offset": ("position", "output.circle_radius"),
    "hole_radius": ("hole", "output.pin_radius"), "pin_radii": ("pin", ""), "output_pin_radius": ("pin", ""),
    "bearing_clearance": ("bearing", ""),
}  # fmt: skip
CHOICES = Choices(
    {FLANK: (0.5, 2.0), HOLE: (0.5, 2.0), "cycloid.eccentricity": (0.8, 1.1), "cycloid.pin_radius": (0.8, 1.2),
     WIDTH: (0.7, 1.5)},
    volume=5.0, limits=dict.fromkeys(("pin_gap", "hole_gap", "hole_wall"), 0.75),
)  # fmt: skip
LEAST = 0.5  # size over that of a known drive, or its inverse, below which a warning is given; assumed
YIELDS = 1.79  # largest contact pressure of a line over the yield strength: von Mises
SLIDING = 0.5  # assumed: share of this pressure for holes, on which the pins slide
FREE = 9 / 8  # assumed: limit of the backlash over the clearance of the unit at the mid-points
HEAD = """# A study of the loaded drive to change, with the numbers of the {name}: replace them by those of your
# drawing, then run rvjax check on this file. Tolerances, costs, clearances and limits are assumed: they follow size,
# process and material by rvjax/study/processes.toml.

"""


def _tables_of(name: str, units: dict[str, str]) -> dict[str, dict[str, PyTree]]:
    """Tables of `processes.toml` by name, quantities in SI: lengths, and those of other units."""
    found = tomllib.loads((resources.files("rvjax.study") / "processes.toml").read_text("utf-8"))[name]

    def si(key: str, value: PyTree) -> PyTree:
        return float(parse(value, units.get(key, "m"))) if isinstance(value, str) else value

    return {row: {key: si(key, value) for key, value in table.items()} for row, table in found.items()}


PROCESSES = _tables_of("process", {})
MATERIALS = _tables_of("material", {"young_modulus": "Pa", "yield_strength": "Pa"})


def process_of(given: Known) -> str:
    """The process of a drive: that of the user, else the usual one of a known drive, else the first of the table.

    Args:
        given: the drive as its source gives it.
    """
    return given.process or OWN.get(given.base, (next(iter(PROCESSES)),))[0]


def material_of(given: Known) -> str:
    """The material of the discs: by a modulus that is no assumed one, else the usual one if the process has it.

    Args:
        given: the drive as its source gives it.
    """
    if MODULUS in given.numbers and not _assumed(given, MODULUS):
        return min(MATERIALS, key=lambda name: abs(math.log(given.numbers[MODULUS] / MATERIALS[name]["young_modulus"])))
    able = PROCESSES[process_of(given)]["materials"]
    own = OWN.get(given.base, ("", ""))[1]
    return own if own in able else str(able[0])


def _assumed(given: Known, path: str) -> bool:
    """True if a number may be replaced: a known drive has it without a source, and the user does not give it."""
    return path not in given.stated and bool(ASSUMED.search(given.said.get(path, "")))


def _donor(given: Known) -> str:
    """The known drive that a drive begins with, else the one whose pin circle is nearest by its ratio."""
    ring = given.numbers[RING]
    return given.base or min(RATED, key=lambda name: abs(math.log(ring / number_at(BASES[name], RING))))


def _outside(size: float, near: str) -> tuple[str, ...]:
    """Line on a drive that is far smaller or larger than the known one whose numbers it has."""
    far = f"{RING}: {size:.3g} times that of the {near}, whose numbers are scaled"
    return () if LEAST <= size <= 1 / LEAST else (far,)


def growth(numbers: Numbers, process: str, path: str) -> float:
    """Ratio of a tolerance to that of the table, rounded to 0.01.

    Args:
        numbers: of the design by path, SI.
        process: by name.
        path: of the radius that it belongs to; "" for parts that are bought.
    """
    if not path or not PROCESSES[process]["grows"]:
        return 1.0
    own, example = (tolerance_unit(2 * x) for x in (numbers[path], number_at(BASES[EXAMPLE], path)))
    return round(float(own / example), 2)


def completed(given: Known, example: CycloidalReducer) -> tuple[Numbers, dict[str, Assumed]]:
    """Numbers of a drive that are taken over, and those that its source lacks or only assumes.

    Args:
        given: the drive as its source gives it.
        example: of the embedded study; not read, because the nearest known drive is closer.
    """
    process, material, near = process_of(given), material_of(given), _donor(given)
    table, own, donor = PROCESSES[process], MATERIALS[material], BASES[near]
    size = float(given.numbers[RING] / number_at(donor, RING))
    like = f"assumed: as the {near}" + (f", for {size:.3g} times its size" if abs(size - 1) > 1e-9 else "")
    flank, hole = (growth(given.numbers, process, path) for path in (RING, "output.circle_radius"))
    softer, far = own["seat"] / MATERIALS[OWN[near][1]]["seat"], _outside(size, near)
    seat = like + (f", in {material}" if softer != 1 else "")
    found = {
        "cycloid.pin_count": Assumed(given.numbers["cycloid.disc_teeth"] + 1, "follows: one more than the lobes"),
        DISCS: Assumed(donor.cycloid.disc_count, f"assumed: as the {near}"),
        FLANK: Assumed(flank * table["flank_clearance"], f"assumed: {process}"),
        HOLE: Assumed(hole * table["hole_clearance"], f"assumed: {process}"),
        MODULUS: Assumed(own["young_modulus"], f"assumed: {material}"),
        POISSON: Assumed(own["poisson_ratio"], f"assumed: {material}"),
        SEAT: Assumed(number_at(donor, SEAT) * size**0.8 * softer, seat, far),
        WIDTH: Assumed(number_at(donor, WIDTH) * size, like, far),
        **{path: Assumed(number_at(donor, path), "assumed: steel") for path in PINS},
    }
    stand = {p: x for p, x in given.numbers.items() if p not in found or not _assumed(given, p)}
    return stand, {path: item for path, item in found.items() if path not in stand}


def rated_torque(given: Known) -> Assumed:
    """Rated torque, N m: that of the nearest known drive, with the same share of the largest pressure of the material.

    It grows with discs, width, the square of size and pressure, and the softness of the contact.

    Args:
        given: the drive as its source gives it.
    """
    near, numbers = _donor(given), given.numbers
    donor, material, usual = BASES[near], material_of(given), OWN[near][1]
    size = numbers[RING] / number_at(donor, RING)
    discs = numbers.get(DISCS, donor.cycloid.disc_count) / donor.cycloid.disc_count
    wider = numbers.get(WIDTH, number_at(donor, WIDTH) * size) / number_at(donor, WIDTH)
    stronger = MATERIALS[material]["yield_strength"] / MATERIALS[usual]["yield_strength"]
    ratio = float(discs * wider * size**2 * stronger**2 * _stiffness(usual) / _stiffness(material))
    if abs(ratio - 1) < 1e-9:
        return Assumed(RATED[near], "rated torque of the catalogue")
    return Assumed(
        float(f"{RATED[near] * ratio:.2g}"), f"assumed: from {RATED[near]:g} N m of the {near}", _outside(size, near)
    )


def _stiffness(material: str) -> float:
    """Plane modulus of a contact with steel pins, Pa."""
    soft = (1 - MATERIALS[name]["poisson_ratio"] ** 2 for name in (material, "steel"))
    return 1 / sum(part / MATERIALS[name]["young_modulus"] for part, name in zip(soft, (material, "steel")))


def free_play(numbers: Numbers, bearing: float) -> float:
    """Backlash of one disc by its clearances alone, rigid parts, rad (docs/models/single_stage.md, Eqs. 4 and 19).

    Args:
        numbers: of the design by path, SI.
        bearing: radial clearance of the eccentric bearing, m.
    """
    e, flank, hole = (float(numbers[path]) for path in ("cycloid.eccentricity", FLANK, HOLE))
    pins, flank, hole = int(numbers["output.count"]), max(flank, 0.0), max(hole, 0.0) / 2
    lever = math.cos(math.pi / (pins * (2 if pins % 2 else 1))) * numbers["output.circle_radius"]  # the shortest best
    aside = np.linspace(0, min(bearing, flank), 200)
    turned = (np.sqrt(bearing**2 - aside**2) + np.sqrt(flank**2 - aside**2)) / (e * numbers["cycloid.disc_teeth"])
    of_output = numbers["cycloid.disc_teeth"] / numbers["cycloid.pin_count"] if numbers.get("member") == "ring" else 1.0
    return float(2 * of_output * np.max(turned + (hole + aside) / lever))


def _tables(text: str, numbers: Numbers, given: Known) -> str:
    """Tables of the example with tolerances, torque and limits of this drive.

    Args:
        text: of the example.
        numbers: of the design by path, SI.
        given: the drive, with its rated torque.
    """
    process, material = process_of(given), material_of(given)
    table, usual = PROCESSES[process], PROCESSES[OWN[EXAMPLE][0]]
    note = f"assumed: {process}"
    ratios = {
        error: (table[key] / usual[key] * growth(numbers, process, path), note) for error, (key, path) in SIZES.items()
    }
    pressure = YIELDS * MATERIALS[material]["yield_strength"]
    backlash = FREE * free_play(numbers, table["bearing"] / 2)
    why = given.torque.why if given.torque and given.torque.why.startswith("assumed") else None
    strength = f"assumed: {YIELDS:g} times the yield strength of {material}"
    limits = {
        "backlash": (f"{float(f'{backlash / arcmin:.2g}'):g} arcmin", "assumed: 1/8 above the clearances"),
        "turn_pin_pressure": (in_unit(pressure, "Pa", 2), strength),
        "hole_pressure": (in_unit(SLIDING * pressure, "Pa", 2), f"{strength}, half of it"),
    }

    def line(path: tuple[str, ...], match: re.Match[str]) -> str:
        if path[0] == "requirement":
            value, reason = limits.get(path[1], ("", ""))
            return stated(match, value, reason, f"initially {value}") if value else match[0]
        if path[0] == "conditions":
            return with_torque(path, match, given.torque.value if given.torque else None, why)
        return scaled_line(path, match, ratios)

    return rewritten(text, line)


START = Start(EXAMPLE, PARTS, HEAD, completed, _tables, choices=CHOICES)
"""A new study of a drive."""
