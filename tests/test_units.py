"""Units as multipliers and as text."""

import math

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
        ("3 microns", "m", r"unit 'microns' \(did you mean um\?\)"),
        ("15 rev/min", "rad/s", r"unit 'rev/min' \(did you mean r/min\?\)"),
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
