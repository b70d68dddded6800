"""Units as multipliers and as text."""

import math
import re
from pathlib import Path

import pytest

from rvjax import units


def test_multipliers():
    assert 180 * units.deg == math.pi
    assert 60 * units.arcmin == pytest.approx(units.deg) and 60 * units.arcsec == pytest.approx(units.arcmin)
    assert 60 * units.rpm == pytest.approx(2 * math.pi)
    assert 3.5 * units.mm == pytest.approx(3500 * units.um) == pytest.approx(0.0035)
    assert units.GPa == 1000 * units.MPa


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("3.5 mm", "m", 0.0035),
        ("-2 arcmin", "rad", -2 * units.arcmin),
        ("6e8 N/m", "N/m", 6e8),
        (0.3, "-", 0.3),
        ("3.5mm", "m", 0.0035),
        ("4 \u00b5m", "m", 4e-6),  # micro sign
        ("4 \u03bcm", "m", 4e-6),  # Greek letter
        ("412 Nm", "N m", 412.0),
        ("1 N·m/arcmin", "N m/rad", 1 / units.arcmin),
        ("600 N/µm", "N/m", 6e8),
        ("5 N/mm", "N/m", 5e3),
        ("1 kg m²", "kg m2", 1.0),
        ("15 r/min", "rad/s", math.pi / 2),
        ("15 rpm", "rad/s", math.pi / 2),
        ("15 1/min", "rad/s", math.pi / 2),
        ("90 deg/s", "rad/s", math.pi / 2),
        ("0.25 turn/s", "rad/s", math.pi / 2),
        ("0.25 turn", "rad", math.pi / 2),
        ("100 gon", "rad", math.pi / 2),
        ("2 mrad", "rad", 2e-3),
        ("3 urad", "rad", 3e-6),
        ("3 µrad", "rad", 3e-6),
        ("7 mN m", "N m", 7e-3),
        ("7 mNm", "N m", 7e-3),
        ("7 N*m", "N m", 7.0),
        ("7 N⋅m", "N m", 7.0),
        ("7 N cm", "N m", 0.07),
        ("7 N mm", "N m", 7e-3),
        ("1 kgf m", "N m", 9.80665),  # the standard weight of a kilogram
        ("1 kgf cm", "N m", 0.0980665),
        ("1 lbf ft", "N m", 1.3558179483314004),  # NIST SP 811, appendix B
        ("1 lbf in", "N m", 0.1129848290276167),
        ("1 kgf mm", "N m", 9.80665e-3),
        ("1 gf cm", "N m", 9.80665e-5),
        ("1 ozf in", "N m", 7.0615518333e-3),  # NIST SP 811, appendix B
        ("7 cN m", "N m", 0.07),
        ("7 daN m", "N m", 70.0),
        ("7 N･m", "N m", 7.0),
        ("7 N・m", "N m", 7.0),
        ("3 g cm2", "kg m2", 3e-7),
        ("3 kg cm²", "kg m2", 3e-4),
        ("3 1/s", "1/s", 3.0),
    ],
)
def test_parse(text, unit, value):
    assert units.parse(text, unit) == pytest.approx(value)


@pytest.mark.parametrize(
    ("value", "unit", "words"),
    [
        ("3.5 kg", "m", "unit 'kg' is not one of m, mm, um"),
        ("mm 3.5", "m", "a number, a space and a unit"),
        ("3,5 mm", "m", 'decimals are written with a point: "3.5 mm"'),
        ("6,5", "-", "'6,5': must be a plain finite number; decimals are written with a point: 6.5$"),
        ("6000 hours", "s", r"unit 'hours' \(did you mean h\?\) is not one of s, h"),
        ("3 nm", "m", "unit 'nm' is not one of m, mm, um"),  # a thousandth of the nearest word
        ("3 MN m", "N m", "unit 'MN m' is not one of N m,"),
        ("3 dN m", "N m", "unit 'dN m' is not one of N m,"),
        ("3 kgm2", "N m", "unit 'kgm2' is not one of N m,"),
        ("3 kg mm2", "kg m2", "unit 'kg mm2' is not one of kg m2,"),
        ("3 MN/m", "N/m", "unit 'MN/m' is not one of N/m,"),
        ("3 marcsec", "rad", "unit 'marcsec' is not one of rad,"),
        ("3 arcsecd", "rad", r"unit 'arcsecd' \(did you mean arcsec\?\)"),
        ("3 oz-in", "N m", r"unit 'oz-in' \(did you mean ozf in\?\)"),
        ("3 microns", "m", r"unit 'microns' \(did you mean um\?\)"),
        ("15 rev/min", "rad/s", r"unit 'rev/min' \(did you mean rpm\?\)"),
        ("1 000 mm", "m", "a number, a space and a unit"),
        ("3.5", "m", "unit '' is not one of"),
        (3.5, "m", "needs a unit"),
        ("inf m", "m", "finite"),
        ("1e307 kN m", "N m", "'1e307 kN m': must be finite, in N m"),
        pytest.param("9" * 400 + " mm", "m", "finite", id="huge length"),
        pytest.param(10**400, "-", "^10{400}: must be a plain finite number", id="huge integer"),
        ("3 mm", "-", "plain finite number"),
        (True, "-", "plain finite number"),
    ],
)
def test_parse_refuses(value, unit, words):
    with pytest.raises(ValueError, match=words):
        units.parse(value, unit)


def test_readable_units():
    assert units.readable("rad") == ("arcmin", units.arcmin)
    assert units.readable("m") == ("um", units.um)
    assert units.readable("N") == ("N", 1.0)


@pytest.mark.parametrize(
    ("unit", "quantity", "spellings"),
    [
        ("deg", "rad", ["°", "º", "Deg", "DEG", "degrees", "deg."]),
        ("arcmin", "rad", ["′", "'", "arc min", "arc-minutes"]),
        ("arcsec", "rad", ["″", '"', "''", "”", "ARCSEC", "arc-sec", "arc sec", "asec"]),
        ("turn", "rad", ["rev", "turns", "Revolutions"]),
        ("urad", "rad", ["µrad", "μrad", "microradians"]),
        ("N m", "N m", ["Nm", "N·m", "N*m", "N.m", "N-m", "N⋅m", "nm", "NM"]),
        ("mN m", "N m", ["mNm", "mN·m"]),
        ("N m", "N m", ["N･m", "N・m", "N×m", "Ｎ・ｍ", "Н·м"]),
        ("cN m", "N m", ["cNm", "cN·m"]),
        ("ozf in", "N m", ["oz in", "oz-in", "ozf·in", "in-oz", "OZ-IN"]),
        ("gf cm", "N m", ["gf·cm", "gcm", "g cm", "gf.cm"]),
        ("kgf cm", "N m", ["kg cm", "kg·cm", "kgf･cm"]),
        ("kgf m", "N m", ["kg m", "kgf・m", "kp m"]),
        ("g cm2", "kg m2", ["g·cm²", "gcm2", "g cm^2"]),
        ("kg cm2", "kg m2", ["kg・cm²", "kgcm^2"]),
        ("kgf m/arcmin", "N m/rad", ["kgf・m/arc.min"]),
        ("arcmin", "rad", ["分", "분"]),
        ("arcsec", "rad", ["秒", "초"]),
        ("N mm", "N m", ["Nmm", "N·mm"]),
        ("lbf ft", "N m", ["ft-lb", "lb-ft", "lbf·ft", "ft lbf"]),
        ("lbf in", "N m", ["in-lb", "lbf·in"]),
        ("rpm", "rad/s", ["RPM", "min-1", "min^-1", "r.p.m.", "rev/min", "U/min"]),
        ("1/min", "rad/s", ["1/min"]),
        (None, "rad", ["grad", "sec", "min", "s", "um", "count", "%", ""]),  # the German degree is no gon
        (None, "N m", ["N m m", "m·N·m", "N·m/m"]),  # products with a length more
        (None, "N m", ["MNm", "mnm", "kg cm2", "N/m"]),  # meganewton or millinewton: capitals decide
    ],
)
def test_a_header_may_spell_a_unit_as_people_do(unit, quantity, spellings):
    assert [units.recognised(spelling, units.KNOWN[quantity]) for spelling in spellings] == [unit] * len(spellings)


def test_reports_choose_usual_units_only():
    assert units.suited(2e-3, "rad")[0] == "arcmin" and units.suited(7.0, "rad")[0] == "rad"
    assert units.suited(0.5, "N m") == ("N m", 1.0) and units.suited(2.0, "N m") == ("N m", 1.0)


def test_a_plain_number_is_written_without_a_unit():
    """And no other place writes a number with its unit, where "-" would follow one that has none."""
    assert [units.with_unit(0.76, unit) for unit in ("-", "mm")] == ["0.76", "0.76 mm"]
    package = Path(units.__file__).parent
    for path in {*package.rglob("*.py")} - {package / "units.py", *package.glob("published/*.py")}:
        assert not re.search(r":[^{}]*[efg]\} \{(unit|shown)\}", path.read_text()), path
