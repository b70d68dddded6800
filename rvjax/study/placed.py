"""Tolerances of errors with a place, in the words of a drawing.

A runout of 15 um is an eccentricity of up to 7.5 um in any direction, a position "diametral 20 um" one of up to 10 um.
Models without places use the same table: their bounds follow from the placed errors of each unit.
"""

from collections.abc import Sequence

from rvjax import models
from rvjax.errors import described, placed_by
from rvjax.population import DISTRIBUTIONS
from rvjax.records import Design, PyTree
from rvjax.study.values import Toml, choice, known, naming_field, quantity, subtable

WORDS = ("runout", "position", "cumulative")
RING = "pin_ring"  # positions and radii of all pins, as one field
LIMITS = {"lower", "upper", "half_width", "grade"}


def spelled(design: Design, table: Toml) -> Toml:
    """The table [tolerances] with the words of drawings as limits and distributions.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    fields = {name: entry for name, entry in table.items() if name != RING}
    if RING in table:
        for name, entry in _ring(subtable(table, RING)).items():
            if name in fields:
                raise ValueError(f"tolerances.{name}: tolerances.{RING} has it too; give one of them")
            fields[name] = entry
    own = design.error_record
    return {name: _limits(own, name, entry) if isinstance(entry, dict) else entry for name, entry in fields.items()}


def _ring(table: Toml) -> Toml:
    """Every pin of the ring with its own part and the share `batch` that all have in common."""
    where = f"tolerances.{RING}"
    known(table, {"position", "radius", "batch", "cp"}, where)
    if not {"position", "radius"} & set(table):
        raise ValueError(f"{where}: give position, radius or both")
    common = {key: table[key] for key in ("batch", "cp") if key in table}
    made: Toml = {}
    with naming_field(where):
        if "position" in table:
            made["pin_offset"] = common | _vector(_length(table["position"], f"{where}.position", "diametral"))
        if "radius" in table:
            made["pin_radii"] = common | {"half_width": _text(_length(table["radius"], f"{where}.radius"))}
    return made


def _limits(error_record: object, field: str, table: Toml) -> Toml:
    """One tolerance with limits in the place of a word."""
    where, words = f"tolerances.{field}", [word for word in WORDS if word in table]
    if "spectrum" in table:
        table = {"distribution": "spectrum"} | table
    if not words:
        return table
    word = words[0]
    if other := [key for key in (*words[1:], *sorted(LIMITS & set(table)))]:
        raise ValueError(f"{where}: give {word} or {other[0]}, not both")
    vectors = described(error_record, "vector")
    teeth = [name for name, axes in described(error_record, "shape").items() if axes[-1] == "teeth"]
    if word == "cumulative" and field not in teeth:
        raise ValueError(f"{where}.cumulative = {table[word]!r}: is of teeth round a disc, of {', '.join(teeth)} alone")
    if word != "cumulative" and field not in vectors:
        raise ValueError(f"{where}.{word} = {table[word]!r}: is of an error with a direction, of {', '.join(vectors)}")
    rest = {key: value for key, value in table.items() if key != word}
    size = _length(table[word], f"{where}.{word}", "diametral" if word == "position" else "")
    if word == "cumulative":  # from the highest to the lowest tooth
        return rest | {"half_width": _text(size / 2)}
    laws = [name for name, law in DISTRIBUTIONS.items() if law.of_vectors]
    choice(rest.get("distribution", "rayleigh"), laws, f"{where}.distribution")
    return _vector(size) | rest


def _length(value: object, where: str, before: str = "") -> float:
    """A length, not negative, that may have to begin with a word that says how it is meant."""
    if before:
        words = value.split(maxsplit=1) if isinstance(value, str) else []
        if len(words) != 2 or words[0] != before:
            raise ValueError(f'{where} = {value!r}: say the diameter of the zone, as in "{before} 20 um"')
        found = quantity(words[1], "m", where)
    else:
        found = quantity(value, "m", where)
    if found < 0:
        raise ValueError(f"{where} = {value!r}: must not be negative")
    return found


def _vector(diameter: float) -> Toml:
    """Vectors of any direction, of a length up to half of a runout or of the diameter of a zone."""
    return {"distribution": "rayleigh", "lower": _text(0.0), "upper": _text(diameter / 2)}


def _text(value: float) -> str:
    return f"{value!r} m"


def refuse_unplaced(kind: models.Kind, outputs: Sequence[str], tolerances: PyTree) -> None:
    """Raise an error for a tolerance with a place that no required model supports.

    Raises:
        ValueError: names the key, and who could.
    """
    by_output = {name: placed_by(tolerances, kind.described[name].name) for name in kind.outputs}
    for field in described(tolerances, "placed"):
        if getattr(tolerances, field) is not None and not any(field in by_output[name] for name in outputs):
            able = sorted((n for n in kind.outputs if field in by_output[n]), key=lambda n: -len(by_output[n]))
            shown = ", ".join(able[:3]) + (" .." if len(able) > 3 else "")
            raise ValueError(f"tolerances.{field}: no response required here can place it, only {shown}")
