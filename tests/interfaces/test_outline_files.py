"""Files of outlines, read by ezdxf and parsers of the standard library."""

import csv
import io
import xml.etree.ElementTree as ElementTree

import ezdxf
import numpy as np
import pytest

from rvjax import catalogue, geometry
from rvjax.units import mm


@pytest.fixture(scope="module")
def drawn():
    design = catalogue.CYCLOIDAL_17
    return {"disc 0": geometry.outline(design), "ring": geometry.outline(design, part="ring")}


def test_ezdxf_reads_the_drawing(drawn):
    drawing = ezdxf.read(io.StringIO(geometry.DRAWINGS[".dxf"](drawn, ["first", "second"]).decode()))
    assert not drawing.audit().errors and drawing.header["$INSUNITS"] == 4 and drawing.dxfversion == "AC1024"
    assert [drawing.header.custom_vars.get(f"RVJAX {k}") for k in (0, 1)] == ["first", "second"]
    space = drawing.modelspace()
    (line,) = space.query("LWPOLYLINE")
    assert line.closed and line.dxf.layer == "DISC_0_FLANK"
    np.testing.assert_allclose(np.array([p[:2] for p in line]) * mm, drawn["disc 0"].flank, atol=1e-12)
    circles = {}
    for circle in space.query("CIRCLE"):
        circles.setdefault(circle.dxf.layer, []).append((circle.dxf.center.x, circle.dxf.center.y, circle.dxf.radius))
    assert {name: len(own) for name, own in circles.items()} == {
        "DISC_0_HOLE": 6, "DISC_0_BORE": 1, "RING_PIN": 18, "RING_PIN_CIRCLE": 1,
    }  # fmt: skip
    assert circles["DISC_0_HOLE"][0] == pytest.approx((32.3, 0, 4.135))


def test_svg_and_csv_have_the_same_numbers(drawn):
    root = ElementTree.fromstring(geometry.DRAWINGS[".svg"](drawn, ["a < b"]))
    name = "{http://www.w3.org/2000/svg}"
    assert root.find(f"{name}desc").text == "a < b" and root.get("width").endswith("mm")
    points = [tuple(map(float, p.split(","))) for p in root.find(f".//{name}polygon").get("points").split()]
    np.testing.assert_allclose(np.array(points) * mm, drawn["disc 0"].flank, atol=1e-9)
    assert len(root.findall(f".//{name}circle")) == 26
    left, top, width, height = map(float, root.get("viewBox").split())
    assert left == top == -width / 2 == -height / 2 and width / 2 > 45
    lines = geometry.DRAWINGS[".csv"](drawn, ["about"]).decode().splitlines()
    assert lines[0] == "# about" and "# disc 0, hole 0: centre 32.3, 0 mm, radius 4.135 mm" in lines
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    flank = drawn["disc 0"]
    for key, due in (
        ("x [mm]", flank.flank[:, 0] / mm), ("y [mm]", flank.flank[:, 1] / mm),
        ("normal [deg]", np.degrees(flank.normal)),
        ("radius of curvature [mm]", 1 / flank.curvature / mm),
    ):  # fmt: skip
        np.testing.assert_allclose([float(row[key]) for row in rows], due, rtol=1e-10, atol=1e-12)
