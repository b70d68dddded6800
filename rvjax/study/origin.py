"""Origin of each value of a design: the study, the published reducer it begins with, or other numbers.

Derived values of a design: ratio, gaps, undercut, contact ratio.
"""

import dataclasses
import math
import re
from collections.abc import Iterator

from rvjax import catalogue
from rvjax._jax.compile_cache import ONCE, quick
from rvjax._reducer.plausible import shown, walk
from rvjax.designs import CamRollerReducer, InvoluteStage, RVReducer
from rvjax.geometry import contact_ratio, least_convex_radius
from rvjax.records import Array, Design, PyTree, Scalar
from rvjax.study.design import AGREE, BASES, GEARS
from rvjax.study.values import Toml


def facts_of(design: Design) -> Iterator[tuple[str, str]]:
    """(name, value) of what follows from the numbers of a design; nothing for a kind that is not in the catalogue."""
    if isinstance(design, CamRollerReducer):
        yield "rollers", str(design.gear_teeth + 1)
    if not isinstance(design, RVReducer):
        return
    cycloid, stage = design.cycloid, design.involute
    gap = 2 * (cycloid.pin_circle_radius * math.sin(math.pi / cycloid.pin_count) - cycloid.pin_radius)
    k1 = cycloid.shortening_coefficient
    smallest, ratio = map(float, _geometry(k1, stage, cycloid.pin_count))
    least = smallest * cycloid.pin_circle_radius
    yield "ratio", f"{design.ratio:.6g}"
    yield "K1", f"{float(k1):.4g}"
    yield "gap between pins", shown(gap, "m")
    sharp = "undercut" if cycloid.pin_radius >= least else "no undercut"
    yield (
        "largest pin without undercut",
        f"{shown(least, 'm')} radius; the pins have {shown(cycloid.pin_radius, 'm')}: {sharp}",
    )
    yield "contact ratio of the gears", f"{ratio:.3g} (teeth without shift)"


@dataclasses.dataclass(frozen=True)
class Number:
    """A number of a design.

    Attributes:
        path: in the design, such as "cycloid.pin_count".
        value: SI, or a count.
        unit: SI unit, "-" for none.
        meaning: of the field.
        origin: where it comes from, in words.
        assumed: true if its source, or the study, marks it as not published.
    """

    path: str
    value: PyTree
    unit: str
    meaning: str
    origin: str
    assumed: bool


def design_numbers(design: PyTree, given: Toml, text: str) -> list[Number]:
    """Numbers of a design with their origin.

    Args:
        design: the reducer.
        given: the table [design] of its study.
        text: of the study, whose comments may say that a number is assumed.
    """
    base = str(given.get("base", ""))
    sources, own = catalogue.sources(base), comments(text)
    published = BASES.get(base)
    found, stated = [], given_paths(given)
    for path, value, about in walk(design):
        # A number that is neither given nor the published one has followed from others.
        kept = published is not None and path in sources and _same(value, _at(published, path))
        if path in stated:
            origin, said = "this study", own.get(path, "")
        elif (derived := _derived(design, path, value)) and not (kept and stated.isdisjoint(_FROM)):
            origin, said = derived, ""
        elif kept:
            said = sources[path]
            origin = f"{base}: {said}" if said else base
        else:
            origin, said = "default", ""
        found.append(Number(path, value, about["unit"], about["meaning"], origin, is_assumed(said)))
    return found


_FROM = {f"involute.{name}" for name in (*GEARS, *AGREE)}  # paths that gears and crank circle are derived from


def _derived(design: PyTree, path: str, value: Scalar) -> str:
    """Derivation of a number of standard gears, or of the crank circle, with the numbers of this design; else ""."""
    if not isinstance(design, RVReducer):
        return ""
    stage = design.involute
    gears = InvoluteStage.from_teeth(**{name: getattr(stage, name) for name in GEARS})
    module, angle = shown(stage.module, "m"), f"cos {math.degrees(float(stage.pressure_angle)):g} deg"
    how = {
        "involute.centre_distance": (gears.centre_distance, f"{module} ({stage.sun_teeth} + {stage.planet_teeth})/2"),
        "involute.sun_radius": (gears.sun_radius, f"{module} * {stage.sun_teeth}/2"),
        "involute.sun_base_radius": (gears.sun_base_radius, f"{module} * {stage.sun_teeth}/2 * {angle}"),
        "involute.planet_base_radius": (gears.planet_base_radius, f"{module} * {stage.planet_teeth}/2 * {angle}"),
        "cranks.circle_radius": (stage.centre_distance, "the centre distance"),
    }
    if path not in how or not math.isclose(float(value), float(how[path][0]), rel_tol=1e-9):
        return ""
    return f"derived: {how[path][1]}"


def comments(text: str, table: str = "design") -> dict[str, str]:
    """The comment at each key of a table in a study file, by its path; that of its header if it says "assumed".

    Args:
        text: of the study.
        table: such as "design" or "requirement".
    """
    found, section, heading = dict[str, str](), "", ""
    for line in text.splitlines():
        if header := re.match(r"\s*\[([^\]]*)\]\s*(?:#\s*(.*))?", line):
            section, heading = header[1].strip(), header[2] or ""
        elif section.split(".")[0] == table and (key := re.match(r"\s*([\w.-]+)\s*=[^#]*(?:#\s*(.*))?$", line)):
            path = ".".join([*section.split(".")[1:], key[1]])
            found[path] = "; ".join(filter(None, [key[2], heading if heading.startswith("assumed") else ""]))
    return found


def is_assumed(text: str) -> bool:
    """True if a comment marks a value as not published."""
    return bool(catalogue.ASSUMED.search(text))


def _same(value: PyTree, other: PyTree) -> bool:
    return other is not None and bool((value == other) if not hasattr(value, "shape") else (value == other).all())


def _at(record: object, path: str) -> PyTree:
    for name in path.split("."):
        record = getattr(record, name, None)
    return record


@quick(2, options=ONCE)  # one program instead of one for each operation
def _geometry(k1: Scalar, stage: InvoluteStage, pins: int) -> tuple[Array, Array]:
    """Least radius without undercut over that of the pin circle, and contact ratio."""
    return least_convex_radius(k1, pins=pins), contact_ratio(stage)


def given_paths(table: Toml, prefix: str = "") -> set[str]:
    """Paths of the numbers that a table [design] gives."""
    found = set[str]()
    for key, value in table.items():
        found |= given_paths(value, f"{prefix}{key}.") if isinstance(value, dict) else {prefix + key}
    return found
