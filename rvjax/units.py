"""SI multipliers, and numbers with units as text.

Write ``3.5 * mm``, divide by a unit to read a result in it. Everything inside rvjax is SI (m, rad, N,
N m, kg, s, Pa); text with units ("3.5 mm") is for study files and reports only.
"""

import difflib
import math
import re
import unicodedata
from collections.abc import Collection

from rvjax.base.words import UnknownWord, unknown

mm = 1e-3
um = 1e-6
deg = math.pi / 180
arcmin = deg / 60
arcsec = deg / 3600
rpm = 2 * math.pi / 60
MPa = 1e6
GPa = 1e9
GRAVITY, POUND, FOOT = 9.80665, 0.45359237, 0.3048  # m/s2, kg, m: exact by definition
_FORCES = {"kgf": GRAVITY, "gf": GRAVITY / 1000, "lbf": POUND * GRAVITY, "ozf": POUND * GRAVITY / 16}  # N
_ARMS = {"kgf": {"m": 1.0, "cm": 1e-2, "mm": mm}, "gf": {"cm": 1e-2}, "lbf": {"ft": FOOT, "in": FOOT / 12}}
_ARMS["ozf"] = {"in": FOOT / 12}
_TORQUES = {f"{f} {arm}": _FORCES[f] * length for f, own in _ARMS.items() for arm, length in own.items()}

# For each SI unit, the units a person may write.
KNOWN: dict[str, dict[str, float]] = {
    "m": {"m": 1.0, "mm": mm, "um": um, "cm": 1e-2},
    "m3": {"m3": 1.0, "cm3": 1e-6, "mm3": 1e-9},
    "rad": {"rad": 1.0, "deg": deg, "arcmin": arcmin, "arcsec": arcsec}
    | {"mrad": 1e-3, "urad": 1e-6, "turn": 2 * math.pi, "gon": math.pi / 200},
    "rad/s": {"rad/s": 1.0, "rpm": rpm, "r/min": rpm, "1/min": rpm, "deg/s": deg, "turn/s": 2 * math.pi},
    "rad/s2": {"rad/s2": 1.0},
    "N": {"N": 1.0, "kN": 1e3},
    "N m": {"N m": 1.0, "kN m": 1e3, "mN m": 1e-3, "N cm": 1e-2, "N mm": 1e-3, "cN m": 1e-2, "daN m": 10.0} | _TORQUES,
    "N/m": {"N/m": 1.0, "N/mm": 1e3, "N/um": 1e6},
    "N m s/rad": {"N m s/rad": 1.0},
    "N m/rad": {"N m/rad": 1.0, "N m/arcmin": 1 / arcmin, "kgf m/arcmin": GRAVITY / arcmin},
    "Pa": {"Pa": 1.0, "MPa": MPa, "GPa": GPa},
    "W": {"W": 1.0, "kW": 1e3},
    "kg": {"kg": 1.0, "g": 1e-3},
    "kg m2": {"kg m2": 1.0, "kg cm2": 1e-4, "g cm2": 1e-7},
    "s": {"s": 1.0, "h": 3600.0},
    "1/s": {"1/s": 1.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
}

# Units that are read, but not chosen for a number in a report.
_READ_ONLY = {"mrad", "urad", "turn", "gon", "r/min", "1/min", "deg/s", "turn/s"}
_READ_ONLY |= {"mN m", "N cm", "N mm", "cN m", "daN m", *_TORQUES, "kgf m/arcmin", "cm", "g", "kg cm2", "g cm2"}

# What the headers of a bench have for a unit, without spaces and points, in lower case.
_ALIASES = {
    "deg": ("°", "degree", "degrees", "degs", "angulardegree", "度", "도", "град"),
    "arcmin": ("'", "arcmins", "arcminute", "arcminutes", "minuteofarc", "minutesofarc", "角分", "分", "분", "углмин"),
    "arcsec": ('"', "''", "arcsecs", "asec", "arcs", "arcsecond", "arcseconds", "secondsofarc", "角秒", "秒", "초",
               "углсек"),
    "rad": ("radian", "radians", "弧度"),
    "mrad": ("milliradian", "milliradians"),
    "urad": ("microradian", "microradians"),
    "turn": ("turns", "rev", "revs", "revolution", "revolutions", "转", "圈"),
    "gon": ("gons",),
    "count": ("counts", "cnt", "cnts", "tick", "ticks", "pulse", "pulses", "inc", "increment", "increments"),
    "rpm": ("rpm", "min1", "rev/min", "revs/min", "u/min", "turn/min", "turns/min", "r/min", "转/分", "转/min", "轉/分",
            "回転/分", "об/мин"),
    "deg/s": ("°/s", "degrees/s", "deg/sec", "dps"),
    "turn/s": ("rev/s", "revs/s", "rps", "r/s", "turns/s"),
    "N m": ("nm", "newtonmeter", "newtonmeters", "newtonmetre", "newtonmetres", "牛米", "牛顿米", "牛頓米", "нм"),
    "kN m": ("knm",),
    "lbf ft": ("lbft", "ftlb", "ftlbf", "ftlbs", "lbsft"),
    "lbf in": ("lbin", "inlb", "inlbf", "inlbs", "lbsin"),
    "ozf in": ("ozin", "inoz", "inozf"),
    "kgf m": ("kpm", "kgm"),
    "kgf cm": ("kpcm", "kgcm"),
    "kgf mm": ("kgmm",),
    "gf cm": ("gcm",),
    "h": ("hour", "hours", "hr", "hrs"),
    "s": ("sec", "second", "seconds"),
    "degC": ("°c", "℃", "c", "degc", "celsius", "degcelsius", "degreec", "degreescelsius", "摄氏度"),
    "Hz": ("hertz", "cps"),
    "kHz": ("khz",),
    "um": ("micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres", "微米"),
    "mm": ("millimeter", "millimeters", "millimetre", "millimetres", "毫米"),
}  # fmt: skip
_ALIAS = {word: unit for unit, words in _ALIASES.items() for word in words}
_PRIMES = str.maketrans({"º": "°", "′": "'", "’": "'", "‘": "'", "´": "'", "″": '"', "”": '"', "“": '"', "˝": '"'})
_BETWEEN = re.compile(r"[\s·・*.⋅∙•‧×^_-]+")
_LIKE = 0.85  # likeness of a misspelt word; all such words have more letters than a unit with a prefix

# The unit in which a person reads a manufacturing error or a response.
READ_IN = {"m": "um", "m3": "cm3", "rad": "arcmin", "Pa": "MPa"}


_NUMBER_AND_UNIT = re.compile(
    r"([-+]?(?:\d[\d_]*\.?\d*|\.\d+|\d*inf|nan)(?:[eE][-+]?\d+)?)\s*((?:(?<=\s)1/)?[^\W\d_].*|)"
)


def spelling(name: str) -> str:
    """Return the spelling of a unit in this module: "um" for "µm", "N m" for "Nm" and "N·m"."""
    name = unicodedata.normalize("NFKC", name.strip().translate(_PRIMES)).replace("\u03bc", "u").replace("\u2212", "-")
    return re.sub(r"N\s*[·・*.⋅∙•‧-]?\s*m(?!m)\b", "N m", name)


def recognised(name: str, known: Collection[str]) -> str | None:
    """Return the unit that the header of a table means, "deg" for "°" and "rpm" for "min^-1"; None if there is none.

    Args:
        name: as written.
        known: units that the quantity may have.
    """
    plain, bare = spelling(name), _BETWEEN.sub("", spelling(name))
    words = [word for word in _BETWEEN.split(plain) if word]
    if len(set(words)) < len(words):  # "N m m" is a product of lengths, not "N mm"
        return None
    for unit in known:
        if unit == plain or bare == _BETWEEN.sub("", unit):  # "mNm" and "MNm" differ
            return unit
    meant = _ALIAS.get(bare.casefold()) or next((u for u in _ALIASES if u.isalpha() and u == bare.casefold()), None)
    return meant if meant in known else None


def unknown_unit(what: str, name: str, known: Collection[str], rule: str = " is not one of") -> UnknownWord:
    """Return the error of a unit that is not in its list; it names another one only if that has the same size.

    Args:
        what: argument or key with its value, as the message begins.
        name: as written.
        known: units that the quantity may have.
        rule: text before the list.
    """
    meant = intended(name, known)
    return unknown(f"{what} (did you mean {meant}?)" if meant else what, "", known, rule)


def intended(name: str, known: Collection[str]) -> str | None:
    """Return the unit with another spelling, or a long word misspelt; None if the unit may have another size.

    Args:
        name: as written.
        known: units that the quantity may have.
    """
    if found := recognised(name, known):
        return found
    words = {word: unit for word, unit in (_ALIAS | {unit: unit for unit in known}).items() if unit in known}
    bare = _BETWEEN.sub("", spelling(name)).casefold()
    near = difflib.get_close_matches(bare, [word for word in words if len(word) > 5 and word.isalpha()], 1, _LIKE)
    return words[near[0]] if near and not bare.endswith(near[0]) else None  # "marcsec" is smaller


def parse(value: object, unit: str) -> float:
    """Return a number in SI from text such as "3.5 mm"; `unit` is the SI unit that is expected.

    Args:
        value: text with a unit, or a plain number where `unit` is "-".
        unit: SI unit, "-" for none.

    Raises:
        ValueError: describes the input error; the caller adds the name of the field.
    """
    if unit == "-":
        try:
            if isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value):
                return float(value)
        except OverflowError:  # an integer beyond every float
            pass
        hint = point_for(value) if isinstance(value, str) else ""
        raise ValueError(f"{value!r}: must be a plain finite number{hint}")
    units = KNOWN[unit]
    if not isinstance(value, str):
        one = "one number" if isinstance(value, (list, dict, bool)) else "a unit"
        raise ValueError(f'{value!r}: needs {one} in quotes, like "3.5 {next(iter(units))}" ({", ".join(units)})')
    split = _NUMBER_AND_UNIT.fullmatch(value.strip())
    if split is None:
        example = f'must be a number, a space and a unit, like "3.5 {next(iter(units))}"'
        raise ValueError(f"{value!r}: {example}{point_for(value)}")
    result, name = float(split[1]), spelling(split[2])
    if name not in units:
        raise unknown_unit(f"{value!r}: unit {name!r}", name, units)
    if not math.isfinite(result * units[name]):
        raise ValueError(f"{value!r}: must be finite, in {unit} too")
    return result * units[name]


def point_for(text: str) -> str:
    """Hint for a number with a decimal comma: the same with a point, in quotes if it has a unit; else "".

    Args:
        text: a number and perhaps a unit, as written.
    """
    right = text.strip().replace(",", ".", 1)
    if "," not in text or (split := _NUMBER_AND_UNIT.fullmatch(right)) is None:
        return ""
    return "; decimals are written with a point: " + (f'"{right}"' if split[2] else right)


def unit_of(value: str, unit: str) -> str:
    """Return the unit that a text was written in, as this module spells it.

    Args:
        value: text that `parse` takes.
        unit: SI unit that is expected, not "-".
    """
    parse(value, unit)
    found = _NUMBER_AND_UNIT.fullmatch(value.strip())
    return spelling(found[2]) if found else unit


def suited(value: float, unit: str) -> tuple[str, float]:
    """Name and SI size of the largest usual unit in which a value is at least one, else of the smallest there is.

    Args:
        value: SI.
        unit: its SI unit.
    """
    usual = {name: size for name, size in KNOWN.get(unit, {unit: 1.0}).items() if name not in _READ_ONLY}
    sizes = sorted(usual.items(), key=lambda item: -item[1])
    return next((item for item in sizes if abs(value) >= item[1]), sizes[-1])


def with_unit(number: float, unit: str, form: str = ".4g") -> str:
    """A number and its unit as text; a plain number has none.

    Args:
        number: in the unit.
        unit: its name, "-" for a plain number.
        form: format of the number.
    """
    return f"{number:{form}}" if unit in ("-", "") else f"{number:{form}} {unit}"


def readable(unit: str, read_in: str | None = None) -> tuple[str, float]:
    """Name and SI size of the unit in which a person reads errors and responses given in `unit`.

    Args:
        unit: SI.
        read_in: another unit; None: the usual one.
    """
    name = READ_IN.get(unit, unit) if read_in is None else read_in
    return name, KNOWN.get(unit, {}).get(name, 1.0)
