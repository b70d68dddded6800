"""Outlines as files for CAD and wire EDM: DXF by ezdxf (extra `cad`), SVG and CSV; lengths in millimetres."""

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from xml.sax.saxutils import escape

import numpy as np

from rvjax.geometry.outline import Circle, Outline
from rvjax.units import deg, mm

Outlines = Mapping[str, Outline]  # by part
_LINE = 0.1  # mm, width of a line in SVG


def layer(part: str, name: str = "flank") -> str:
    """Layer of a feature, such as "DISC_0_HOLE": the same for all circles of a row.

    Args:
        part: such as "disc 0".
        name: of the circle.
    """
    return f"{part} {name.rstrip('0123456789').strip()}".upper().replace(" ", "_")


def _features(outlines: Outlines) -> list[tuple[str, np.ndarray | Circle]]:
    """Layer with points (n, 2) mm of a closed line, or with a circle, of all parts."""
    found = list[tuple[str, np.ndarray | Circle]]()
    for part, one in outlines.items():
        if len(one.flank):
            found.append((layer(part), np.asarray(one.flank, float) / mm))
        found += [(layer(part, circle.name), circle) for circle in one.circles]
    return found


def dxf(outlines: Outlines, about: Sequence[str]) -> bytes:
    """DXF R2010 in millimetres: a layer for each feature, closed LWPOLYLINE and CIRCLE.

    Args:
        outlines: by part; each about the origin.
        about: lines of the comment, kept as properties of the drawing.

    Raises:
        ImportError: ezdxf is not installed.
    """
    try:
        import ezdxf
    except ImportError:
        raise ImportError("DXF needs ezdxf: pip install 'rvjax[cad]'") from None
    drawing = ezdxf.new("R2010", units=4)  # type: ignore[attr-defined]
    for number, line in enumerate(about):
        drawing.header.custom_vars.append(f"RVJAX {number}", line)
    space = drawing.modelspace()
    for name, shape in _features(outlines):
        if name not in drawing.layers:
            drawing.layers.add(name)
        if isinstance(shape, Circle):
            centre = float(shape.x) / mm, float(shape.y) / mm
            space.add_circle(centre, float(shape.radius) / mm, dxfattribs={"layer": name})
        else:
            space.add_lwpolyline(shape, close=True, dxfattribs={"layer": name})
    stream = io.StringIO()
    drawing.write(stream)
    return stream.getvalue().encode("utf-8")


def svg(outlines: Outlines, about: Sequence[str]) -> bytes:
    """SVG in millimetres, y upwards: a group for each layer.

    Args:
        outlines: by part.
        about: lines of the comment.
    """
    shapes = _features(outlines)
    reach = 1.05 * max((_reach(shape) for _, shape in shapes), default=1.0)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * reach:.6g}mm" height="{2 * reach:.6g}mm" '
        f'viewBox="{-reach:.6g} {-reach:.6g} {2 * reach:.6g} {2 * reach:.6g}">',
        f"<desc>{escape(' '.join(about))}</desc>",
        f'<g transform="scale(1,-1)" fill="none" stroke="black" stroke-width="{_LINE}">',
    ]
    for name in dict.fromkeys(name for name, _ in shapes):
        lines.append(f'<g id="{name}">')
        lines += [_drawn(shape) for other, shape in shapes if other == name]
        lines.append("</g>")
    return "\n".join([*lines, "</g>", "</svg>", ""]).encode("utf-8")


def _reach(shape: np.ndarray | Circle) -> float:
    if isinstance(shape, Circle):
        return (float(np.hypot(shape.x, shape.y)) + float(shape.radius)) / mm
    return float(np.hypot(*shape.T).max())


def _drawn(shape: np.ndarray | Circle) -> str:
    if isinstance(shape, Circle):
        x, y, radius = (float(value) / mm for value in (shape.x, shape.y, shape.radius))
        return f'<circle cx="{x:.9g}" cy="{y:.9g}" r="{radius:.9g}"/>'
    return '<polygon points="' + " ".join(f"{x:.9g},{y:.9g}" for x, y in shape) + '"/>'


def table(outlines: Outlines, about: Sequence[str]) -> bytes:
    """CSV of the points of the flanks; circles are lines of its comment.

    Args:
        outlines: by part.
        about: lines of the comment.
    """
    stream = io.StringIO()
    for line in about:
        stream.write(f"# {line}\n")
    for part, one in outlines.items():
        for circle in one.circles:
            x, y, radius = (float(value) / mm for value in (circle.x, circle.y, circle.radius))
            stream.write(f"# {part}, {circle.name}: centre {x:.9g}, {y:.9g} mm, radius {radius:.9g} mm\n")
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(["part", "x [mm]", "y [mm]", "normal [deg]", "radius of curvature [mm]"])
    for part, one in outlines.items():
        with np.errstate(divide="ignore"):
            numbers = np.column_stack(
                [np.asarray(one.flank) / mm, np.asarray(one.normal) / deg, 1 / np.asarray(one.curvature) / mm]
            )
        rows.writerows([part, *(f"{number:.12g}" for number in row)] for row in numbers)
    return stream.getvalue().encode("utf-8")


DRAWINGS: dict[str, Callable[[Outlines, Sequence[str]], bytes]] = {".dxf": dxf, ".svg": svg, ".csv": table}
"""Content of a file by its ending."""
