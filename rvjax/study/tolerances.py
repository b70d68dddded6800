"""Table [tolerances] of a study.

Tolerances of errors with a place, in the words of a drawing, and back: tables and study files state them so.

A runout of 15 um is an eccentricity of up to 7.5 um in any direction, a position "diametral 20 um" one of up to 10 um.
Models without places use the same table: their bounds follow from the placed errors of each unit.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from rvjax import models
from rvjax.base.fields import axis_sizes
from rvjax.errors import described, placed_by
from rvjax.population import COMMON, DISTRIBUTIONS
from rvjax.records import Design, PyTree, Record, Shape
from rvjax.study.values import Metadata, Toml, choice, integer, known, naming_field, quantity, subtable
from rvjax.tolerances import Tolerance, for_design

RING = "pin_ring"  # positions and radii of all pins, as one field


@dataclasses.dataclass(frozen=True)
class Form:
    """Way in which a drawing states a tolerance.

    Attributes:
        word: key of the study.
        half_widths: its number, in half-widths of the error.
        before: word before the number.
        vector: whether it limits the length of a vector; else deviations to both sides.
    """

    word: str
    half_widths: float
    before: str = ""
    vector: bool = False

    @property
    def stated(self) -> str:
        """Words before the number in a table; "" for limits on both sides, which a drawing states as limits."""
        return "" if self.half_widths == 1 else f"{self.word} {self.before}".strip()

    def limits(self, number: float) -> Toml:
        """Limits and distribution in a study, from the number of the drawing, SI."""
        half = number / self.half_widths
        if not self.vector:
            return {"half_width": _text(half)}
        return {"distribution": "rayleigh", "lower": _text(0.0), "upper": _text(2 * half)}

    def number(self, tolerance: Tolerance) -> float | None:
        """Number of the drawing, SI; None if it does not define the limits."""
        lower, upper = float(tolerance.lower), float(tolerance.upper)
        moved = abs(lower if self.vector else lower + upper) > 1e-9 * upper
        return None if moved else self.half_widths * (upper - lower) / 2


FORMS = {
    "runout": Form("runout", 4.0, vector=True),  # twice the largest eccentricity
    "position": Form("position", 4.0, "diametral", vector=True),  # diameter of the zone
    "cumulative": Form("cumulative", 2.0),  # from the highest to the lowest tooth
}
RING_FORMS = {"pin_offset": FORMS["position"], "pin_radii": Form("radius", 1.0)}
"""Fields of a ring of pins."""
LIMITS = {"lower", "upper", "half_width", "grade"}


def spelled(design: Design, table: Toml) -> Toml:
    """The table [tolerances]; terms of drawings become limits and distributions.

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


def forms(table: Toml) -> dict[str, Form]:
    """Fields that a table [tolerances] states in the words of drawings, with their forms."""
    ring = subtable(table, RING)
    found = {field: form for field, form in RING_FORMS.items() if form.word in ring}
    for field, entry in table.items():
        if field != RING and isinstance(entry, dict):
            found.update((field, form) for word, form in FORMS.items() if word in entry)
    return found


def stated_by(forms: Mapping[str, Form], field: str) -> tuple[str, float]:
    """The words that state a tolerance, and their number in half-widths: ("half-width", 1), ("runout", 4).

    Args:
        forms: of the study.
        field: name of the error.
    """
    form = forms.get(field)
    return (form.stated, form.half_widths) if form is not None and form.stated else ("half-width", 1.0)


def _ring(table: Toml) -> Toml:
    """Tolerances of each pin of the ring, with the common share `batch`."""
    where = f"tolerances.{RING}"
    known(table, {"position", "radius", "batch", "cp"}, where)
    if not {"position", "radius"} & set(table):
        raise ValueError(f"{where}: give position, radius or both")
    common = {key: table[key] for key in ("batch", "cp") if key in table}
    made: Toml = {}
    with naming_field(where):
        for field, form in RING_FORMS.items():
            if form.word in table:
                made[field] = common | form.limits(_length(table[form.word], f"{where}.{form.word}", form.before))
    return made


def _limits(error_record: object, field: str, table: Toml) -> Toml:
    """One tolerance with limits instead of the term of a drawing."""
    where, words = f"tolerances.{field}", [word for word in FORMS if word in table]
    if "spectrum" in table:
        table = {"distribution": "spectrum"} | table
    if not words:
        return table
    word = words[0]
    if other := [key for key in (*words[1:], *sorted(LIMITS & set(table)))]:
        raise ValueError(f"{where}: give {word} or {other[0]}, not both")
    vectors = described(error_record, "vector")
    teeth = [name for name, axes in described(error_record, "shape").items() if axes[-1] == "teeth"]
    form = FORMS[word]
    if not form.vector and field not in teeth:
        raise ValueError(f"{where}.{word} = {table[word]!r}: only errors of teeth have it: {', '.join(teeth)}")
    if form.vector and field not in vectors:
        raise ValueError(f"{where}.{word} = {table[word]!r}: only vectors have it: {', '.join(vectors)}")
    rest = {key: value for key, value in table.items() if key != word}
    limits = form.limits(_length(table[word], f"{where}.{word}", form.before))
    if form.vector:
        laws = [name for name, law in DISTRIBUTIONS.items() if law.of_vectors]
        choice(rest.get("distribution", "rayleigh"), laws, f"{where}.distribution")
    return limits | rest


def _length(value: object, where: str, before: str = "") -> float:
    """A length >= 0; some need a leading word such as "diametral"."""
    if before:
        words = value.split(maxsplit=1) if isinstance(value, str) else []
        if len(words) != 2 or words[0] != before:
            raise ValueError(f'{where} = {value!r}: must be the diameter of the zone, such as "{before} 20 um"')
        found = quantity(words[1], "m", where)
    else:
        found = quantity(value, "m", where)
    if found < 0:
        raise ValueError(f"{where} = {value!r}: must not be negative")
    return found


def _text(value: float) -> str:
    return f"{value!r} m"


def by_error(tolerances: Record) -> dict[str, Tolerance]:
    """Tolerances that are given, by error, in the order of the error record; each field has a Tolerance or None."""
    fields = {f.name: getattr(tolerances, f.name) for f in dataclasses.fields(tolerances)}
    return {name: tolerance for name, tolerance in fields.items() if tolerance is not None}


def scalars(tolerances: Record) -> dict[str, Tolerance]:
    """Tolerances of numbers, not of vectors, by error."""
    return {name: one for name, one in by_error(tolerances).items() if not one.law.of_vectors}


def mid_points(tolerances: Record, record: type[Record]) -> PyTree:
    """Errors of the unit at the mid-points of all limits; vectors have theirs at 0.

    Args:
        tolerances: a Tolerance or None in each field.
        record: class of the errors.
    """
    return record(**{name: np.float64(one.middle) for name, one in scalars(tolerances).items()})


def refuse_unplaced(kind: models.Kind, outputs: Sequence[str], tolerances: Record) -> None:
    """Raise an error for a tolerance with a place that no required model supports.

    Raises:
        ValueError: names the key, and who could.
    """
    by_output = {name: placed_by(tolerances, kind.described[name].name) for name in kind.outputs}
    for field in described(tolerances, "placed"):
        if getattr(tolerances, field) is not None and not any(field in by_output[name] for name in outputs):
            able = sorted((n for n in kind.outputs if field in by_output[n]), key=lambda n: -len(by_output[n]))
            shown = ", ".join(able[:3]) + (" .." if len(able) > 3 else "")
            raise ValueError(f"tolerances.{field}: required responses do not use it, only {shown}")


def metadata(record: type[Record], field: str) -> Metadata:
    """Metadata of a field of a class of records."""
    return record.__dataclass_fields__[field].metadata


def parse_tolerances(design: Design, table: Toml, folder: Path) -> PyTree:
    """Read the table [tolerances], limits in the words of drawings included.

    Args:
        design: the reducer.
        table: as written.
        folder: that files named in the study are relative to.

    Raises:
        ValueError: names the key, its value and the unit.
    """
    table = spelled(design, table)
    fields = {f.name for f in dataclasses.fields(design.error_record)}
    known(table, fields, "tolerances")
    made = {}
    for field in table:
        where = f"tolerances.{field}"
        with naming_field(where):
            about, own = metadata(design.error_record, field), dict(subtable(table, field))
            shape = _series(about["shape"], design.counts, own, where)
            made[field] = parse_tolerance(own, about["unit"], where, folder, shape)
    return for_design(design, **made)


def _series(axes: Shape, counts: Mapping[str, int], table: Toml, where: str) -> tuple[int, ...]:
    """Shape of a series, whose number of harmonics is taken out of its table; () where the design defines all sizes."""
    own = [axis for axis in axes if isinstance(axis, str) and axis not in counts]
    if not own:
        return ()
    if "harmonics" not in table:
        raise ValueError(f"{where}.harmonics is missing: an integer, the number of terms of the series")
    harmonics = integer(table.pop("harmonics"), f"{where}.harmonics", 1, 1000)
    return axis_sizes(axes, {**counts, **dict.fromkeys(own, harmonics)}, (0,) * len(axes))


def parse_tolerance(
    table: Toml, unit: str, where: str, folder: Path = Path(), shape: tuple[int, ...] = ()
) -> Tolerance:
    """Read the tolerance of one error.

    Args:
        table: as written.
        unit: SI unit of the error.
        where: name of the table, for messages.
        folder: that files named in it are relative to.
        shape: of the error; () where the design defines it.
    """
    law = DISTRIBUTIONS[choice(table.get("distribution", "normal"), DISTRIBUTIONS, f"{where}.distribution")]
    known(table, {"lower", "upper", "half_width", "grade", "size", "distribution", *COMMON, *law.parameters()}, where)
    if "cp" in table and not law.capable:
        raise ValueError(f"{where}.cp = {table['cp']!r}: {law.name} ends at the limits, it has no capability")
    options: dict[str, PyTree] = {"distribution": law, "shape": shape}
    options |= {key: quantity(table[key], "-", f"{where}.{key}") for key in COMMON if key in table}
    for key in law.parameters():
        if key in table:
            value = table[key]
            if isinstance(value, dict) and isinstance(value.get("file"), str):
                value = value | {"file": str(folder / value["file"])}
            options[key] = law.parsed(key, value, unit)
    size = quantity(table["size"], "m", f"{where}.size") if "size" in table else None
    ways = [{"lower", "upper"}, {"half_width"}, {"grade", "size"}]
    given = set(table) & {"lower", "upper", "half_width", "grade"}
    chosen = next((way for way in ways if given and given == way - {"size"}), None)
    if chosen is None or (chosen == ways[2] and size is None):
        raise ValueError(f"{where}: give lower and upper, or half_width, or grade and size")
    if chosen == ways[2] and size is not None:
        if unit != "m":
            raise ValueError(f"{where}.grade = {table['grade']!r}: grades are for lengths, this error is in {unit}")
        grade: PyTree = table["grade"]
        return Tolerance.grade(grade, size, **options)
    if size is not None and unit != "m":
        raise ValueError(f"{where}.size = {table['size']!r}: sizes are for lengths, this error is in {unit}")
    limits = {key: quantity(table[key], unit, f"{where}.{key}") for key in sorted(given)}
    if chosen == ways[1]:
        if limits["half_width"] < 0:
            raise ValueError(f"{where}.half_width = {table['half_width']!r}: must not be negative")
        return Tolerance.symmetric(limits["half_width"], size=size, **options)
    return Tolerance(limits["lower"], limits["upper"], size=size, **options)
