"""`rvjax assemble` and `rvjax compensate`: from parts or points to a results folder; bad files in one line.

Oracles: the plan from the same parts in Python; the fit of a drive by a linear programme; the orders of the curve.
"""

import csv
import json
import math
import re

import matplotlib.pyplot as plt
import numpy as np
import pytest
from cycloidal_cases import dictionaries

from rvjax import cli, compensation, study
from rvjax.assembly import plan
from rvjax.commands.assemble import Price, _others as others, _price_plot as price_plot, bench, prices
from rvjax.commands.assemble.matching import price_table
from rvjax.commands.compensate import corrections
from rvjax.units import arcsec, um
from tests.oracles import cycloidal as oracle

STUDY = """
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 8
closure = "first_order"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[tolerances.disc_bore]
half_width = "6.5 um"
[tolerances.bearing_clearance]
lower = "4 um"
upper = "12 um"
[requirement.transmission_error]
upper = "0.25 arcmin"
[assembly]
objective = "yield"
draws = 2
certificate_draws = 4
sd.crank_eccentricity = "0.5 um"
"""
PARTS = """kind,id,stock,crank_eccentricity[0] [um],crank_eccentricity[1] [um],bearing_clearance [um]
crank,C1,,3,-1,
crank,C2,,-2,1,
crank,C3,,,4,
crank,C4,,1,3,
bearings,narrow,1,,,5
bearings,wide,3,,,0.009e3
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my.toml").write_text(STUDY)
    (tmp_path / "parts.csv").write_text(PARTS)
    return tmp_path


def refused(capsys, *arguments):
    """The one line of an error."""
    assert cli.main(list(arguments)) == 2
    line = capsys.readouterr().err.strip()
    assert "\n" not in line and line.startswith("rvjax: error: ")
    return line.removeprefix("rvjax: error: ")


def test_a_list_of_parts_becomes_a_list_for_the_bench(files, capsys, thorough):
    assert cli.main(["assemble", "my.toml", "parts.csv"]) == 0
    said = capsys.readouterr().out
    folder = files / "results" / "my-assembly"
    names = {path.name for path in folder.iterdir()}
    assert names == {"build.csv", "parts.csv", "result.json", "study.toml", "summary.txt", "units.png"}
    assert (folder / "summary.txt").read_text().strip() in said
    question = study.load("my.toml")
    found = bench(question, "parts.csv")
    assert list(found.kinds) == ["crank_0", "crank_1", "bearings", "rest"]
    assert found.kinds["crank_0"] is found.kinds["crank_1"]
    third = found.kinds["crank_0"].parts[2]  # its first journal was not measured
    np.testing.assert_array_equal(third.errors["crank_eccentricity"], [0, 4 * um])
    assert third.sd["crank_eccentricity"].tolist() == [math.inf, 0.5 * um]
    assert found.kinds["rest"].population.keys() == {"disc_bore"}
    expected = plan(
        found.response, found.kinds, objective="yield", requirement=found.requirement, draws=2, certificate_draws=4
    )
    with (folder / "build.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["crank_0"] for row in rows] == [unit["crank_0"] for unit in expected.build]
    assert [row["bearings"] for row in rows] == [unit["bearings"] for unit in expected.build]
    result = json.loads((folder / "result.json").read_text())
    assert result["status"] == "OPTIMAL" and result["seed"] == 0
    assert result["values"] == pytest.approx(expected.values.tolist(), rel=1e-12)
    output = question.output(found.name).shown
    told = [float(row[f"expected {found.name} [{output[0]}]"]) * output[1] for row in rows]
    assert told == pytest.approx(result["values"], rel=1e-9)
    if thorough:  # the same once more; JSON of another command below
        assert cli.main(["assemble", "my.toml", "parts.csv", "--format", "json"]) == 0
        again = json.loads(capsys.readouterr().out)
        assert again.pop("results") == "results/my-assembly-2" and again == result


DRIVE = """
[design]
base = "cycloidal-17"
member = "ring"
output.hole_clearance = "30 um"
[conditions]
samples = 12
[tolerances.hole_radius]
half_width = "10 um"
[tolerances.output_pin_radius]
half_width = "10 um"
[requirement.fit_clearance]
lower = "3 um"
"""


def test_large_clearances_are_good_for_a_drive(files):
    """Limits below and above: the sense of a requirement decides what a plan makes small."""
    (files / "drive.csv").write_text("kind,id,hole_radius[0] [um],output_pin_radius[0] [um]\ndisc,D,1,\ncarrier,C,,1\n")
    found = {}
    for limit in ("lower", "upper"):
        (files / "drive.toml").write_text(DRIVE.replace("lower =", f"{limit} ="))
        found[limit] = bench(study.load("drive.toml", solve=False), "drive.csv").sense
    assert found == {"lower": -1, "upper": 1}


@pytest.mark.long  # test_mounting.py turns discs and carriers, the sense of the limit is held above
def test_discs_and_carriers_of_a_drive_are_matched(files, undrawn):
    """Large clearances are good here: every unit, its parts laid by hand as the list says, has the promised one."""
    rng = np.random.default_rng(3)
    sizes = {f"D{k}": rng.normal(0, 5, 6).round(1) for k in range(4)} | {
        f"C{k}": rng.normal(0, 5, 6).round(1) for k in range(2)
    }
    heads = [f"{name}{place} [um]" for name in ("hole_radius", "output_pin_radius") for place in range(6)]
    heads = [re.sub(r"(\d) \[um", r"[\1] [um", head) for head in heads]
    lines = ["kind,id," + ",".join(heads)]
    for name, own in sizes.items():
        cells = ",".join(map(str, own))
        lines.append(f"disc,{name},{cells},,,,,," if name[0] == "D" else f"carrier,{name},,,,,,,{cells}")
    (files / "drive.toml").write_text(DRIVE)
    (files / "drive.csv").write_text("\n".join(lines) + "\n")
    assert cli.main(["assemble", "drive.toml", "drive.csv"]) == 0
    result = json.loads((files / "results" / "drive-assembly" / "result.json").read_text())
    assert result["status"] == "OPTIMAL"
    assert result["yield_"]["value"] == 1 > 2 * result["random_yield"]["value"] and result["gain"]["lower"] > 3 * um
    assert np.mean(result["values"]) - result["random"]["value"] == pytest.approx(result["gain"]["value"], rel=1e-6)
    design = study.load("drive.toml", solve=False).design
    with (files / "results" / "drive-assembly" / "build.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 and any("over" in row["disc_0 position"] + row["disc_1 position"] for row in rows)

    def laid(row, slot):
        """Radii at the six places: turned over about the x axis first, then turned."""
        own, where = sizes[row[slot]] * um, row[f"{slot} position"]
        own = own[[0, 5, 4, 3, 2, 1]] if "turned over" in where else own
        return np.roll(own, int(re.search(r"(\d+) deg|$", where)[1] or 0) // 60)

    for row, value in zip(rows, result["values"]):
        holes = np.stack([laid(row, "disc_0"), laid(row, "disc_1")])
        errors = {"hole_radius": holes, "output_pin_radius": laid(row, "carrier")}
        due = min(oracle.fit(dictionaries(design), errors, 2 * np.pi * k / 12) for k in range(12))  # of a crank turn
        assert value == pytest.approx(due, rel=1e-9)
        assert value >= 3 * um


BAD_DRIVE_PARTS = [
    ("kind,id,crank_eccentricity[0] [um]\ncrank,a,1\n", "column 'crank_eccentricity[0] [um]': parts of kind 'crank'"),
    ("kind,id,throw [um]\nshaft,a,1\n", "throw of this part has the shape (2,)"),
    ("kind,id,hole_radius[6] [um]\ndisc,a,1\n", "hole_radius of this part has the shape (6,)"),
    ("kind,id,output_pin_radius[0] [um]\ndisc,a,1\n", "parts of kind 'disc' have disc_centre, "),
    ("kind,id,hole_radius[0] [um]\ndisc_2,a,1\n", "kind = 'disc_2': this design has 2 discs, counted from 0"),
    ("kind,id,hole_radius[0] [um]\nDisc,a,1\n", "kind = 'Disc': must be disc, carrier, or a name in lower case"),
]


@pytest.mark.parametrize(("text", "message"), BAD_DRIVE_PARTS, ids=[message for _, message in BAD_DRIVE_PARTS])
def test_a_bad_list_of_parts_of_a_drive_is_one_line(files, capsys, text, message):
    (files / "drive.toml").write_text(DRIVE)
    (files / "bad.csv").write_text(text)
    assert message in refused(capsys, "assemble", "drive.toml", "bad.csv")
    assert not (files / "results").exists()


def cranks(change):
    """A list of 20 cranks within 6 um of eccentricity, one of them changed, and of ten pairs of bearings."""
    rng = np.random.default_rng(0)
    found = rng.normal(0.0, 2.0, (20, 2)).round(1)
    found[7] = change(found[7])
    rows = ["kind,id,crank_eccentricity[0] [um],crank_eccentricity[1] [um],bearing_clearance [um]"]
    rows += [f"crank,C{k},{first:g},{second:g}," for k, (first, second) in enumerate(found)]
    return "\n".join([*rows, *(f"bearings,B{k},,,{5 + 0.5 * k:g}" for k in range(10))]) + "\n"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        pytest.param(
            lambda pair: [500.0, pair[1]],
            r"crank_eccentricity\[0\] = 500 um lies 76\.9 half-widths from the middle",
            id="one",
            marks=pytest.mark.long,
        ),
        pytest.param(
            lambda pair: [1.2, -3.0 * 25.4],
            r"crank_eccentricity\[1\] = -76\.2 um lies 11\.7 half-widths",
            id="inch",
            marks=pytest.mark.long,
        ),
        pytest.param(
            lambda pair: [3.1 * 1000, 2.0 * 1000],
            r"crank_eccentricity\[0\] = 3\.1 mm lies 477 half-widths",
            id="both in mm",
        ),
    ],
)
def test_a_part_in_another_unit_is_named_first_with_its_row(files, capsys, undrawn, change, said):
    """Half-width 6.5 um: one line before the verdict, in the summary too; the other 19 say nothing."""
    (files / "slip.csv").write_text(cranks(change))
    assert cli.main(["assemble", "my.toml", "slip.csv", "--results", "out"]) == 0
    lines = capsys.readouterr().out.strip().splitlines()
    assert re.match(rf"row 9, crank C7: {said}.*; check its unit and sign$", lines[0])
    assert lines[1].startswith("Assembly my: ")
    assert (files / "out" / "summary.txt").read_text().startswith(lines[0])
    assert json.loads((files / "out" / "result.json").read_text())["unusual"] == [lines[0]]


def test_a_column_in_another_unit_names_a_few_and_a_usual_lot_none(files, monkeypatch):
    (files / "right.csv").write_text(cranks(lambda pair: pair))
    asked = study.load("my.toml", solve=False)
    assert bench(asked, "right.csv").unusual == ()
    (files / "wrong.csv").write_text((files / "right.csv").read_text().replace("[um]", "[mm]"))
    lines = bench(asked, "wrong.csv").unusual
    assert len(lines) >= 28 and "half-widths" in lines[0]
    assert others(lines) == [f"{len(lines) - 5} more parts lie as far; a whole column may have the wrong unit"]
    assert others(lines[:5]) == []


def test_a_negative_clearance_is_refused_with_its_row(files, capsys):
    (files / "minus.csv").write_text(PARTS.replace(",,,5", ",,,-5"))
    line = refused(capsys, "assemble", "my.toml", "minus.csv")
    assert line == "minus.csv: row 6, bearing_clearance = '-5': must be zero or positive, in um"


def test_prices_with_and_without_matching_are_drawn_and_told():
    found = [Price(0.9, 12.0, 2.0, 5.0, "OPTIMAL"), Price(0.99, 18.0, 3.0, 7.0, "OPTIMAL")]
    assert price_table(found).text().splitlines()[-1].split() == ["99", "%", "18.000", "3.00", "7.000", "OPTIMAL"]
    axes = price_plot(found)
    assert [line.get_ydata()[1] for line in axes.lines] == [18.0, 7.0]
    plt.close("all")


def test_elements_of_a_list_are_named_as_everywhere(files):
    """`disc_bore[0,1]`, as --save-errors writes it, and the older `disc_bore[0][1]` are the same column."""
    header = 'kind,id,crank_eccentricity[0] [um],"disc_bore[0,1] [um]"\n'
    rows = "disc,D1,,3.5\ndisc,D2,,-1\ncrank,C1,2,\ncrank,C2,1,\n"
    found = []
    for text in (header, header.replace("[0,1]", "[0][1]")):
        (files / "own.csv").write_text(text + rows)
        discs = bench(study.load("my.toml", solve=False), "own.csv").kinds["disc_0"].parts
        found.append([part.errors["disc_bore"] for part in discs])
    np.testing.assert_array_equal(found[0], found[1])
    assert found[0][0][0, 1] == pytest.approx(3.5 * um) and found[0][1][0, 1] == pytest.approx(-1 * um)


def test_a_list_with_decimal_commas_is_the_same_list(files):
    (files / "teile.csv").write_text(PARTS.replace("0.009e3", "9,0").replace(",", ";").replace("9;0", "9,0"))
    own, other = (bench(study.load("my.toml", solve=False), name).kinds for name in ("parts.csv", "teile.csv"))
    for slot in ("crank_0", "bearings"):
        for one, same in zip(own[slot].parts, other[slot].parts, strict=True):
            assert one.id == same.id
            for field in one.errors:
                np.testing.assert_allclose(one.errors[field], same.errors[field], rtol=1e-14)


@pytest.mark.long
def test_matching_opens_the_tolerances_of_a_study(files):
    costs = """
[cost.crank_eccentricity]
scale = 6
reference = "10 um"
finest = "1 um"
coarsest = "40 um"
[run]
samples = 1024
certificate_samples = 16384
"""
    (files / "my.toml").write_text(STUDY + costs)
    question = study.load("my.toml")
    with pytest.warns(UserWarning, match="a clearance cannot be negative"):
        opened = list(prices(question, bench(question, "parts.csv"), sets=2))
    assert opened and all(found.factor > 1 and found.matched < found.alone for found in opened)


BAD_PARTS = [
    ("", 'no table; the first line must name the columns, such as "kind,id,'),
    ("kind,id\n", "no rows under the header 'kind,id'"),
    ("kind,id,pin_radius [um]\npins,a,x\n", "row 2, pin_radius = 'x': must be a number in um"),
    ("kind,id,pin_radius [um]\npins,a,1\npins,b,1e308\n", "row 3, pin_radius = '1e308': too large, must be at most"),
    ("kind,id,pin_radius [um]\npins,a,1e-400\n", "row 2, pin_radius = '1e-400': too small, must be 0 or at least"),
    ("kind,id,pin_radius [um]\npins,a,NaN\n", "row 2, pin_radius = 'NaN': must be finite, in um; leave the cell empty"),
    ("kind,id,pin_radius [um]\npins,a,-inf\n", "row 2, pin_radius = '-inf': must be finite, in um"),
    ("kind,id,pin_radius\npins,a,1\n", "column 'pin_radius': must be like 'bearing_clearance [um]'"),
    ("kind,id,pin_radius [s]\npins,a,1\n", "column 'pin_radius [s]': unit 's' is not one of m, mm, um"),
    ("kind,id,disc_bore[0,1 [um]\ndisc,a,1,2\n", "column 'disc_bore[0': must be like 'bearing_clearance [um]'"),
    ("kind,id,pin_radius [um],pin_radius [um]\npins,a,1,2\n", "two columns have the same name, 'pin_radius [um]'"),
    ("kind,id,gear [um]\npins,a,1\n", "column 'gear [um]': parts of kind 'pins' have "),
    ("kind,id,crank_eccentricity[2] [um]\ncrank,a,1\n", "crank_eccentricity of this part has the shape (2,)"),
    ("kind,id,stock,pin_radius [um]\npins,a,-1,1\n", "pins 'a': stock = '-1': must be a whole number, 0 or more"),
    ("kind,id,pin_radius [um]\npins,a,1\npins,a,2\n", "pins: part 'a': duplicate id"),
    ("kind,id,pin_radius [um]\npins,,1\n", "a part of kind 'pins' has no id"),
    ("kind,id,pin_radius [um]\npins,a,1\n", "has parts of pins only; list parts of at least two slots"),
    ("kind,id,pin_radius [um]\npins,a,1,2\n", "row 2 has 4 cells, the header 3"),
    ("kind,id,pin_radius [um]\npins,a,\n", "parts of kind 'pins' have no error"),
    ("kind,id,disc_bore[0][0] [um]\ndisc_4,a,1\n", "kind = 'disc_4': this design has 2 discs, counted from 0"),
    ("kind,id,disc_pitch[0] [um]\ndisc,a,1\n", "not all elements of disc_pitch are measured"),
]


@pytest.mark.parametrize(("text", "message"), BAD_PARTS, ids=[message for _, message in BAD_PARTS])
def test_a_bad_list_of_parts_is_one_line(files, capsys, text, message):
    (files / "bad.csv").write_text(text)
    assert message in refused(capsys, "assemble", "my.toml", "bad.csv")
    assert not (files / "results").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('objective = "yield"', 'objective = "best"'), "assembly.objective = 'best': must be one of mean, bottle"),
        (("draws = 2\n", "draws = 0\n"), "assembly.draws = 0: must be an integer of at least 1"),
        (('"0.5 um"', '"-0.5 um"'), "assembly.sd.crank_eccentricity = '-0.5 um': must be zero or positive"),
        (('"0.5 um"', '"0.5"'), "assembly.sd.crank_eccentricity = '0.5'"),
        (("draws = 2\n", "turned = 1\n"), "assembly.turned = 1: must be true or false"),
        (("draws = 2\n", 'response = "misfit"\n'), "assembly.response = 'misfit': must be one of transmission_error"),
    ],
)
def test_a_bad_table_is_one_line(files, capsys, change, message):
    (files / "bad.toml").write_text(STUDY.replace(*change))
    assert message in refused(capsys, "assemble", "bad.toml", "parts.csv")


RATIO = 105.0
ORDERS = {1: 20.0, 3: 2.0, 39: 4.0, 78: 3.0}


def points(noise=0.5, count=1500, way=1.0, seed=0):
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.uniform(0, 360, count))
    error = sum(a * np.cos(np.radians(k * angle) + way * k) for k, a in ORDERS.items())
    return angle, error + 7.0 + noise * rng.standard_normal(count)


def written(path, *curves):
    lines = ["angle [deg],error [arcsec],torque [N m],direction"]
    for angle, error, *rest in curves:
        lines += [",".join(map(repr, map(float, pair))) + "," + ",".join(rest) for pair in zip(angle, error)]
    path.write_text("\n".join(lines) + "\n")


def test_a_measured_curve_becomes_a_table(files, capsys):
    angle, error = points()
    written(files / "curve.csv", (angle, error, "", ""))
    assert cli.main(["compensate", "my.toml", "curve.csv", "--export", "drive.st"]) == 0
    said = capsys.readouterr().out
    rows = compensation.read("drive.st")
    (curve,) = corrections(study.load("my.toml"), "curve.csv").curves
    assert curve.correction.ratio == pytest.approx(RATIO)
    assert curve.correction.order.tolist() == [3, 39, 78]  # order 1 is the mounting of the encoder
    for order, value, sd in zip(curve.correction.order.tolist(), curve.correction.value, curve.correction.sd):
        assert abs(value - ORDERS[order] * arcsec * np.exp(1j * order)) < 5 * sd < 0.2 * arcsec
    # sd of a coefficient from n points: noise sqrt(2/n); 241 of 1500 numbers are fitted
    assert curve.correction.sd == pytest.approx(0.5 * arcsec * math.sqrt(2 / 1500), rel=0.25)
    left = error + np.interp(np.radians(angle), rows.angle, rows.correction) / RATIO / arcsec
    first = 20 * np.cos(np.radians(angle) + 1)
    assert np.std(left - first) == pytest.approx(0.5, rel=0.1)
    assert cli.main(["compensate", "my.toml", "curve.csv", "--export", "t.json", "--format", "json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert again.pop("tables") == ["t.json"] and again.pop("results") == "results/my-compensation-2"
    assert again == json.loads((files / "results" / "my-compensation" / "result.json").read_text())
    with (files / "results" / "my-compensation" / "orders.csv").open(newline="") as file:
        orders = {int(row["order"]): row for row in csv.DictReader(file)}
    assert float(orders[39]["amplitude [arcsec]"]) == pytest.approx(ORDERS[39], abs=0.2)
    assert "3 39 78" in said and (files / "results" / "my-compensation" / "curve.png").is_file()
    with_first = corrections(study.load("my.toml"), "curve.csv", first_order=True, count=1).curves[0]
    assert with_first.correction.order.tolist() == [1]


def test_every_load_and_direction_has_a_table(files, undrawn, capsys):
    forth, back = points(count=400), points(count=400, way=-1.0, seed=1)
    written(files / "curves.csv", (*forth, "100", "forward"), (*back, "100", "backward"))
    assert cli.main(["compensate", "my.toml", "curves.csv", "--export", "t.csv", "--angle-sd", "10 arcsec"]) == 0
    tables = [compensation.read(f"t-100_N_m_{way}.csv") for way in ("forward", "backward")]
    assert np.abs(tables[0].correction - tables[1].correction).max() > 100 * arcsec
    assert "table of another curve" in capsys.readouterr().out


def test_a_curve_in_other_units_with_decimal_commas_is_the_same_curve(files):
    """What a bench in Stuttgart writes: semicolons, decimal commas, a byte order mark, minutes of arc."""
    angle, error = points(count=400)
    written(files / "curve.csv", (angle, error, "12.5", "forward"))
    lines = ["\ufeffDirection;Torque [kN m];Error [arcmin];Angle [rad];note", ";;;1,0;no reading here"]
    for a, e in zip(angle, error):
        cells = (f"{x:.17g}".replace(".", ",") for x in (0.0125, float(e) / 60, math.radians(a)))
        lines.append(f"forward;{';'.join(cells)};")
    (files / "kurve.csv").write_text("\n".join(lines), "utf-8")
    (one,), (other,) = (corrections(study.load("my.toml"), name).curves for name in ("curve.csv", "kurve.csv"))
    assert (other.torque, other.direction) == (12.5, "forward") and other.label == one.label
    np.testing.assert_allclose(other.run.angle, one.run.angle, rtol=1e-15)
    np.testing.assert_allclose(other.run.error, one.run.error, rtol=1e-15)


def test_every_unit_of_a_file_has_a_table(files, undrawn, capsys):
    """Two units whose errors of order 40 oppose each other: merged they would leave nothing to correct."""
    angle = np.arange(0.0, 360.0, 0.5)
    rows = [
        f"{a},{sign * 20 * np.cos(np.radians(40 * a))},{unit}" for unit, sign in (("A", 1), ("B", -1)) for a in angle
    ]
    (files / "two.csv").write_text("\n".join(["angle [deg],error [arcsec],unit", *rows]))
    assert cli.main(["compensate", "my.toml", "two.csv", "--export", "t.csv", "--format", "json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [(curve["unit"], curve["order"]) for curve in told["curves"]] == [("A", [40]), ("B", [40])]
    assert told["tables"] == ["t-A.csv", "t-B.csv"]
    first, second = (compensation.read(path).correction for path in told["tables"])
    amplitude = 20 * arcsec * RATIO
    assert first[0] == pytest.approx(-amplitude, rel=1e-6) and second[0] == pytest.approx(amplitude, rel=1e-6)


def test_a_direction_is_forward_or_backward(files, capsys):
    written(files / "curve.csv", (*points(count=100), "", "forwrd"))
    message = refused(capsys, "compensate", "my.toml", "curve.csv")
    assert "row 2, direction = 'forwrd'" in message and "forward or backward" in message


BAD_CURVES = [
    ("", "no table; the first line must name the columns"),
    ("angle [deg],error [arcsec]\n", "no rows under the header"),
    ("angle [deg],error [arcsec]\n1,\n", "holds no point"),
    ("angle [deg],fault [arcsec]\n1,2\n", 'has no column "error [arcsec]"; it has angle'),
    ("angle [deg],error [um]\n1,2\n", "column 'error [um]': unit 'um' is not known"),
    ("angle [deg],error [arcsec]\n1,x\n", "row 2, error = 'x': must be a number in arcsec"),
    ("angle [deg],error [arcsec]\n,3\n", "row 2, angle is empty"),
    ("angle [deg],error [arcsec]\n1,2,3\n", "row 2 has 3 cells, the header 2 (decimal commas?"),
    ("angle [deg],error [arcsec]\n1,2\n", "1 samples cannot determine 1 numbers"),
    ("angle [deg],error [arcsec]\n" + "5,1\n" * 40, "40 samples cannot determine 9 numbers"),
]


@pytest.mark.parametrize(("text", "message"), BAD_CURVES, ids=[message for _, message in BAD_CURVES])
def test_bad_curves_are_one_line(files, capsys, text, message):
    (files / "bad.csv").write_text(text)
    assert message in refused(capsys, "compensate", "my.toml", "bad.csv")


def test_bad_options_are_one_line(files, capsys):
    written(files / "curve.csv", (*points(count=100), "", ""))
    assert "--export t.dat: must end with one of .csv" in refused(
        capsys, "compensate", "my.toml", "curve.csv", "--export", "t.dat"
    )
    assert "--angle-sd = '5': " in refused(capsys, "compensate", "my.toml", "curve.csv", "--angle-sd", "5")
    assert "no such data file" in refused(capsys, "compensate", "my.toml", "none.csv")
    assert "no such list of parts" in refused(capsys, "assemble", "my.toml", "none.csv")
    with pytest.raises(study.StudyError, match="parts are matched for RV reducers and single-stage cycl"):
        bench(study.load("corr", solve=False), "parts.csv")
