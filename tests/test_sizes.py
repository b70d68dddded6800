"""Sizes for the drawing: rows by hand, a reader that knows the drawings only, and a row for every error.

The reader has the numbers of the drawings of three studies (mm) and what one error does to a size; it takes nothing
from the table of features. Decimal numbers keep a limit of a micrometre exact next to a size of 128 mm.
"""

import csv
import dataclasses
import io
import itertools
import math
from decimal import Decimal

import pytest

from rvjax import study
from rvjax.commands.cells import sizes_table
from rvjax.errors import described
from rvjax.population import coarsest_grade
from rvjax.study import KINDS, number_at, sizes_of
from rvjax.tolerances import Tolerance, for_design
from rvjax.units import arcmin, mm, um

STUDIES = {name: study.load(name, solve=False) for name in ("cycloidal-17", "rv-40e-whole", "corr")}
DRIVE, RV = STUDIES["cycloidal-17"].design, STUDIES["rv-40e-whole"].design

# Size in the design, mm, or None where no design has it; deviation of the size for one of the error.
DRAWINGS = {
    "cycloidal-17": {
        "bearing_clearance": (None, 2), "equidistant_modification": ("0.06", 1), "pin_radii": ("5", 2),
        "throw": ("1.6", 1), "hole_radius": ("8.3", 2), "output_pin_radius": ("5", 2),
    },
    "rv-40e-whole": {
        "crank_eccentricity": ("1.3", 1), "crank_phase": (None, 1), "disc_bore": (None, 1), "carrier_bore": (None, 1),
        "bearing_clearance": (None, 2), "pin_circle_radius": ("128", 2), "pin_radius": ("6", 2),
        "pin_hole_clearance": (None, 1), "equidistant_modification": ("-0.002", 1), "shift_modification": ("0", 1),
        "base_tangent_upper": (None, 1), "base_tangent_lower": (None, 1), "support_clearance": (None, 2),
        "pin_radii": ("6", 2),
    },
    "corr": {"cam_radius": ("270", 2), "eccentricity": ("3.5", 1), "roller_radius": ("16", 2)},
}  # fmt: skip


def read(text, drawing):
    """Limits by error, SI, from a file of sizes."""
    found, seen = {}, set()
    for row in csv.DictReader(io.StringIO(text)):
        error, unit = row["error"], Decimal(repr(arcmin if "[arcmin]" in row["feature"] else um))
        upper = Decimal(row["upper [um]"])
        if error not in drawing:  # a zone
            half = upper / 2
            ends = (-half, half) if "pitch" in row["geometric"] else (Decimal(0), half)
        else:
            size, factor = drawing[error]
            alike, rest = (row["part"], row["nominal [mm]"]), Decimal(0)
            if size is not None and alike not in seen:
                rest = 1000 * (Decimal(row["nominal [mm]"]) - Decimal(size))
                seen.add(alike)
            ends = tuple((Decimal(row[f"{side} [um]"]) + rest) / factor for side in ("lower", "upper"))
        found[error] = tuple(float(end * unit) for end in ends)
    return found


def moved(tolerances, shift):
    """Tolerances with moved mid-points; vectors and the pitch, which drawings state otherwise, keep theirs."""
    changes = {}
    for f in dataclasses.fields(tolerances):
        one = getattr(tolerances, f.name)
        if one is not None and not one.law.of_vectors and f.name != "disc_pitch":
            by = shift * one.half_width * (1 + len(f.name) / 100)
            changes[f.name] = one.replace(lower=one.lower + by, upper=one.upper + by)
    return tolerances.replace(**changes)


@pytest.mark.parametrize("shift", [0.0, -1.618, 3.14159])
@pytest.mark.parametrize("name", STUDIES)
def test_a_file_of_sizes_gives_the_tolerances_back(name, shift):
    one = STUDIES[name]
    tolerances = moved(one.tolerances, shift)
    found = read(sizes_table(sizes_of(one.design, tolerances)).csv().decode(), DRAWINGS[name])
    assert found.keys() == set(one.fields)
    for error, ends in found.items():
        tolerance = getattr(tolerances, error)
        wanted = float(tolerance.lower), float(tolerance.upper)
        assert ends == pytest.approx(wanted, rel=1e-12, abs=1e-12 * max(map(abs, wanted))), error


def test_a_fine_limit_next_to_a_large_size_keeps_its_digits():
    """128.2007 mm are rounded to 128.201. As floats twice 64.1 mm are wrong by 2e-11 um, differences by 1e-11 um."""
    design = RV.replace(cycloid=RV.cycloid.replace(pin_circle_radius=0.0641))
    found = sizes_of(design, for_design(design, pin_circle_radius=Tolerance(0.3 * um, 0.4 * um)))
    (ends,) = read(sizes_table(found).csv().decode(), {"pin_circle_radius": ("128.2", 2)}).values()
    assert ends == pytest.approx((0.3 * um, 0.4 * um), rel=1e-12, abs=0)


def rows(design, **limits):
    """Rows by error; limits in um."""
    given = {name: Tolerance(a * um, b * um) for name, (a, b) in limits.items()}
    return {row.error: row for row in sizes_of(design, for_design(design, **given))}


def check(row, nominal, upper, lower, **more):
    """Nominal in mm and limits in um, to the rounding of numbers in m."""
    assert row.nominal / mm == pytest.approx(nominal, abs=1e-10) if nominal is not None else row.nominal is None
    assert row.upper / um == pytest.approx(upper, abs=1e-9)
    assert row.lower is None if lower is None else row.lower / um == pytest.approx(lower, abs=1e-9)
    assert {name: getattr(row, name) for name in more} == more


def test_rows_of_a_drive_by_hand():
    """Hole: 2 (2.5 + 1.6) + 0.1 = 8.3 mm; -8.61 +-7.73 um of its radius are -17.22 +-15.46 um of its diameter, so that
    8.28278 mm is rounded to 8.283 and 0.22 um stay. Width 30.92 um: IT8 is 22 um, IT9 is 36 um (6 to 10 mm)."""
    found = rows(DRIVE, hole_radius=(-16.34, -0.88), throw=(-10, 10), output_pin_radius=(-2.9, 2.1),
                 bearing_clearance=(0, 20), equidistant_modification=(3, 9.8))  # fmt: skip
    hole = dict(part="disc, 2 x", feature="hole of output pin, diameter", count=6, grade="IT8", geometric="", unit="m")
    check(found["hole_radius"], 8.283, 15.24, -15.68, **hole)
    check(found["throw"], 1.6, 10, -10, part="shaft", count=2, grade="")  # no feature of size
    check(found["output_pin_radius"], 4.999, 5.2, -4.8, part="carrier", count=6, grade="IT6")  # 10 um; IT6 is 8 um
    check(found["bearing_clearance"], None, 40, 0, grade="", geometric="bought-in", count=2)  # ISO 5753-1: diametral
    check(found["equidistant_modification"], 0.066, 3.8, -3, grade="", geometric="line profile (ISO 1101)", count=1)


def test_rows_of_an_rv_40e_by_hand():
    """Pins: two errors of one diameter, 6 mm + 2 (-3 + 1) um; the second row has its whole deviation."""
    found = rows(RV, pin_circle_radius=(2.5, 12.5), crank_eccentricity=(-5.9, 7.1), pin_radius=(-5, -1),
                 pin_radii=(0, 2), disc_bore=(-3, 9))  # fmt: skip
    check(found["pin_circle_radius"], 128.015, 10, -10, part="ring", count=1, grade="IT5")  # 20 um; IT5 is 18 um
    check(found["crank_eccentricity"], 1.301, 6.1, -6.9, part="crankshaft, 2 x", count=2, grade="")
    check(found["pin_radius"], 5.996, 2, -6, part="ring", count=40)
    check(found["pin_radii"], 5.996, 4, 0, part="ring", count=40)
    for side in ("lower", "upper"):  # the whole size, from its rows and from the errors
        whole = 5996 + sum(getattr(found[name], side) / um for name in ("pin_radius", "pin_radii"))
        assert whole == pytest.approx(6000 + 2 * (-5 if side == "lower" else -1 + 2))
    zone = dict(
        part="disc, 2 x", count=2, geometric="position, radial and tangential", datum="axis of the crank circle"
    )
    check(found["disc_bore"], 72, 9, -3, grade="", **zone)


def test_zones_of_a_drawing():
    """Vectors of up to 7.5 um: a runout of 15 um; of up to 20 um: a position of 40 um; teeth at +-9.5 um: 19 um."""
    found = {row.error: row for row in sizes_of(RV, STUDIES["rv-40e-whole"].tolerances)}
    check(found["disc_centre"], None, 15, None, geometric="circular runout (ISO 1101)", datum="bores of the cranks")
    check(found["pin_offset"], 128, 10, None, geometric="position, diametral (ISO 1101)", count=40)
    check(found["disc_pitch"], None, 19, None, geometric="total cumulative pitch deviation Fp (ISO 1328)", count=1)
    assert found["crank_phase"].upper / arcmin == pytest.approx(5) and found["crank_phase"].unit == "rad"
    drive = {row.error: row for row in sizes_of(DRIVE, STUDIES["cycloidal-17"].tolerances)}
    check(drive["hole_position"], 64.6, 40, None, part="disc, 2 x", count=6, datum="bore of the disc")
    bore = rows(RV, disc_bore=(0, 6))["disc_bore"]  # of each component, not of the length
    check(bore, 72, 6, 0, geometric="position, radial and tangential")
    teeth = rows(RV, disc_pitch=(-1, 3))["disc_pitch"]  # no number of a drawing: limits
    check(teeth, None, 3, -1, geometric="total cumulative pitch deviation Fp (ISO 1328)")


def test_a_coarse_process_has_a_coarse_step():
    """Half-widths of 25.5 um: 8.3054 mm becomes 8.31; of 25 um: 8.305. One finer error of a size decides."""
    check(rows(DRIVE, hole_radius=(-22.8, 28.2))["hole_radius"], 8.31, 46.4, -55.6)
    check(rows(DRIVE, hole_radius=(-22.3, 27.7))["hole_radius"], 8.305, 50.4, -49.6)
    both = rows(RV, pin_radius=(-27, 31), pin_radii=(-1, 1))
    check(both["pin_radius"], 6.004, 58, -58)


def test_what_no_design_has_is_empty():
    """Limits are then deviations, of a share in parts of one; the table has percent."""
    found = rows(RV, base_tangent_upper=(-31, 3))["base_tangent_upper"]
    check(found, None, 3, -31, part="sun and planets", grade="", geometric="")
    share = sizes_of(DRIVE, for_design(DRIVE, output_pin_friction=Tolerance(-0.1, 0.2)))[0]
    assert (share.geometric, share.nominal, share.upper, share.unit) == ("no size", None, 0.2, "-")
    written = sizes_table([share]).values()[1][0]
    assert written[1] == "friction of the output pins [%]" and written[4:6] == pytest.approx([20, -10])


def test_rows_of_a_part_are_together():
    parts = [row.part for row in sizes_of(RV, STUDIES["rv-40e-whole"].tolerances)]
    assert len(parts) == 20 and sum(a != b for a, b in itertools.pairwise(parts)) == len(set(parts)) - 1


@pytest.mark.parametrize("kind", KINDS.values(), ids=lambda kind: kind.word)
def test_every_error_of_every_kind_has_a_row(kind):
    """What the records say of the errors (axes, vectors, radii, the number that an error deviates from) holds."""
    design = next(iter(kind.bases.values()))
    fields = {f.name: f.metadata for f in dataclasses.fields(design.error_record)}
    assert fields.keys() == kind.features.keys()
    for name, feature in kind.features.items():
        about = fields[name]
        axes = [axis for axis in (feature.each, *feature.count) if axis]
        assert set(axes) <= design.counts.keys() and feature.part and feature.feature, name
        own = {axis for axis in about["shape"] if axis in design.counts} - {"teeth"}
        assert own <= set(axes), name
        assert bool(about["vector"]) == (feature.form in ("position", "runout")), name
        radial = any(word in about["meaning"] for word in ("radius", "radial clearance")) and about["unit"] == "m"
        assert feature.factor == (2 if radial and not about["vector"] else 1), name
        if feature.nominal and about["of"]:
            assert about["of"] in feature.nominal, name
        assert all(number_at(design, path) is not None for path in feature.nominal), name
        assert feature.geometric == "no size" if about["unit"] == "-" else True, name
        assert bool(feature.datum) >= bool(feature.form), name
    assert {name for name, f in kind.features.items() if f.form == "cumulative"} <= {"disc_pitch"}
    assert "disc_pitch" not in fields or described(design.error_record, "shape")["disc_pitch"][-1] == "teeth"


@pytest.mark.parametrize(
    ("width", "size", "grade"),
    [
        (13.0, 25.0, "IT6"), (13.0 * (1 - 1e-12), 25.0, "IT6"), (12.99, 25.0, "IT5"),
        (20.9, 30.0, "IT6"), (21.0, 30.0, "IT7"), (0.29, 2.0, ""),
        (500.0, 2.0, "IT11"), (20.0, 0.0, ""), (20.0, -1.0, ""), (20.0, 501.0, ""), (20.0, math.nan, ""),
    ],
)  # fmt: skip
def test_the_coarsest_grade_inside_a_width(width, size, grade):
    """ISO 286-1, Table 1: 18 to 30 mm IT5 9, IT6 13, IT7 21 um; up to 3 mm IT01 0.3 um, IT11 60 um."""
    assert coarsest_grade(width * um, size * mm) == grade


def test_without_a_table_limits_are_those_of_the_error(monkeypatch):
    monkeypatch.setattr("rvjax.study.kinds.KINDS", {})
    (row,) = rows(DRIVE, hole_radius=(-4, 6)).values()
    check(row, None, 6, -4, part="discs", feature="radius of each hole; > 0 is clearance", count=1, grade="", datum="")
