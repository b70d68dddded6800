"""`rvjax identify` from CSV to a verdict: what it answers, how it ends, and what it refuses in one line.

The data are virtual units of `four_bar.revolution` itself, laid out along the turn of the output by hand.
"""

import csv
import json

import matplotlib.image
import numpy as np
import pytest

import rvjax
from rvjax import catalogue, cli, four_bar
from rvjax.errors import RVErrors
from rvjax.units import arcsec, deg, um

STUDY = """# A unit from the end of the line.
[design]
base = "rv-40e"
[conditions]
output_torque = "412 N m"
angles = 16
closure = "first_order"
[tolerances.crank_eccentricity]
half_width = "6.5 um"
[tolerances.bearing_clearance]
lower = "4 um"
upper = "12 um"
[tolerances.pin_radius]
half_width = "2 um"
[identify]
model = "four_bar"
orders = [40, 80]
noise = "floor"
nuisance = ["offset", "mounting"]
"""
THROW = np.array([[4.0, -2.0], [1.0, 3.0]]) * um
PLAY = 9.5 * um
KNOWN = 4.0 + 2.0 - 1.0 + 3.0  # um, of the only combination of throws that a curve shows
NOISE = 1.0 * arcsec


def turn(rng, sign, extra=0.0, throw=THROW, samples=1000):
    """Angle (deg, uneven) and error (arcsec) of a run: offset 50, mounting 30 at order 1, finer orders than asked."""
    errors = RVErrors.for_design(catalogue.RV_40E, crank_eccentricity=throw, bearing_clearance=PLAY)
    found = four_bar.revolution(catalogue.RV_40E, errors, output_torque=sign * 412.0, angles=16)
    waves = np.asarray(found.harmonics) / arcsec
    angle = (np.arange(samples) + rng.uniform(-0.4, 0.4, samples)) * 360 / samples
    crank = -40 * angle * deg  # the cranks turn against the output, one turn for each pin
    error = np.real(np.exp(1j * np.outer(crank, np.arange(len(waves)))) @ waves)
    error += 50 + 30 * np.cos(angle * deg - 1) + extra * np.cos(40 * angle * deg)
    return angle, error + NOISE / arcsec * rng.normal(size=samples) * np.sqrt(samples / 2)


def table(runs, unit=None):
    head = "angle [deg],error [arcsec],torque [N m],direction" + (",unit" if unit else "")
    lines = [head]
    for (angle, error), word in runs:
        tail = f",412,{word}" + (f",{unit}" if unit else "")
        lines += [f"{a:.6f},{e:.6f}{tail}" for a, e in zip(angle, error)]
    return "\n".join(lines) + "\n"


def both(rng, unit=None, **changes):
    return table([(turn(rng, 1, **changes), "forward"), (turn(rng, -1, **changes), "backward")], unit)


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    folder = tmp_path_factory.mktemp("identify")
    (folder / "unit.toml").write_text(STUDY)
    (folder / "unit.csv").write_text(both(np.random.default_rng(4)))
    return folder


@pytest.fixture(autouse=True)
def there(here, monkeypatch):
    monkeypatch.chdir(here)


@pytest.fixture(scope="module")
def answered(here):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        code = cli.main(["identify", "unit.toml", "unit.csv", "--results", "out"])
    return code, here / "out", json.loads((here / "out" / "result.json").read_text())


def run(capsys, *arguments):
    code = cli.main(["identify", *arguments, "--quiet"])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_the_unit_is_found(answered):
    """Noise of a reading is such that a part of an order has 1 arcsec; intervals hold the truth (4 sigma here)."""
    code, _, found = answered
    assert code == 0 and found["status"] == "CONVERGED" and found["adequate"] is True
    assert set(found) >= {"status", "adequate", "verdict", "value", "lower", "upper", "directions", "shares", "broken"}
    assert "notes" not in found  # the plain form
    assert set(found) >= {"fit", "next", "seed", "versions"} and found["versions"]["rvjax"] == rvjax.__version__
    assert found["noise"] == pytest.approx(NOISE, rel=0.5)  # a median of 20 amplitudes
    value, lower, upper = (found[key] for key in ("value", "lower", "upper"))
    assert found["verdict"]["bearing_clearance"] == "identified"
    half = (upper["bearing_clearance"] - lower["bearing_clearance"]) / 2
    assert abs(value["bearing_clearance"] - PLAY) < 2 * half < 1 * um
    cells = {k: f"crank_eccentricity[{k[0]},{k[1]}]" for k in np.ndindex(2, 2)}
    assert {found["verdict"][name] for name in cells.values()} == {"combination"}
    seen = sum(value[name] * (1 if i == j else -1) for (i, j), name in cells.items())
    # An arcsecond of order 40 is 4 R arcsec / 2 of the combination, here of two runs.
    assert abs(seen - KNOWN * um) < 4 * 4 * catalogue.RV_40E.cranks.circle_radius * NOISE / np.sqrt(4)
    assert found["verdict"]["pin_radius"] == "unseen" and found["resolution"]["pin_radius"] == pytest.approx(
        0, abs=1e-9
    )
    assert "pin_radius" in found["silent"]
    assert abs(complex(value["mounting[0]"], value["mounting[1]"]) - 30 * arcsec * np.exp(1j)) < 4 * NOISE
    for shares in found["shares"].values():
        assert sum(shares.values()) == pytest.approx(1.0, abs=1e-6)
    assert found["shares"]["order 040"]["crank_eccentricity"] > 0.9
    assert found["next"]["chosen"] == max(found["next"]["gains"], key=found["next"]["gains"].get)
    assert min(found["next"]["gains"].values()) > -1e-9


COMBINATION = "[0,0] - [0,1] - [1,0] + [1,1]"  # of crank eccentricities, which alone are seen


def test_what_is_seen_is_said_in_words(answered):
    _, out, result = answered
    text = (out / "summary.txt").read_text()
    assert COMBINATION in text and "1 identified, 4 in combinations only" in text
    (seen,) = [each for each in result["directions"] if len(each["terms"]) == 4]
    assert seen["lower"] < KNOWN * um < seen["upper"] and seen["upper"] - seen["lower"] < 4 * um and seen["unit"] == "m"
    assert f"{COMBINATION} = {seen['value'] / um:.4g} um [{seen['lower'] / um:.4g}, {seen['upper'] / um:.4g}]" in text
    assert "warning" not in text
    assert "The data do not determine pin_radius" in text and "Measure next:" in text


def test_the_table_of_elements_holds_numbers(answered):
    _, out, result = answered
    with (out / "elements.csv").open(newline="") as file:
        rows = {row["element"]: row for row in csv.DictReader(file)}
    assert rows.keys() == result["value"].keys()
    for name, row in rows.items():
        size = {"um": um, "arcmin": deg / 60, "arcsec": deg / 3600}[row["unit"]]
        for key in ("value", "lower", "upper"):
            assert float(row[key]) * size == pytest.approx(result[key][name], rel=1e-9, abs=1e-20)
        assert float(row["known better by"]) == pytest.approx(max(result["resolution"][name], 0.0), rel=1e-9)
        assert float(row["chance beyond limit"]) == pytest.approx(result["broken"].get(name, 0.0), rel=1e-9)


def test_the_folder_holds_page_tables_and_pictures(answered):
    _, out, _ = answered
    names = {"report.html", "summary.txt", "result.json", "elements.csv", "measurement.csv", "study.toml"}
    pictures = {"curve_1.png", "curve_2.png", "measurement_1.png", "measurement_2.png", "orders.png"}
    pictures |= {"elements.png", "shares.png"}
    assert {path.name for path in out.iterdir()} == names | pictures
    page = (out / "report.html").read_text()
    assert page.count("<figure>") == len(pictures) and "<script" not in page and "http" not in page.split("</style>")[0]
    assert COMBINATION in page and "What to measure next" in page
    for name in pictures:
        picture = matplotlib.image.imread(out / name)
        assert picture.shape[1] > 700 and picture.std() > 0.02
    assert not [path for path in out.parent.iterdir() if path.name.startswith(".")]


def test_check_needs_no_data_where_the_noise_is_known(here, capsys):
    (here / "plan.toml").write_text(STUDY.replace('"floor"', '"1 arcsec"') + 'torques = ["412 N m", "100 N m"]\n')
    before = sorted(here.iterdir())
    code, out, _ = run(capsys, "plan.toml", "--check", "--json")
    found = json.loads(out)
    assert code == 0 and sorted(here.iterdir()) == before
    assert not {"status", "adequate", "value", "lower", "upper", "fit"} & set(found)
    assert found["runs"] == [f"{t} N m {d}" for t in (412, 100) for d in ("forward", "backward")]
    assert found["verdict"]["bearing_clearance"] == "identified" and found["next"]["chosen"] in found["runs"]
    assert found["part_orders"] == []  # two cranks and 39 teeth: the housing makes every order
    code, _, said = run(capsys, "unit.toml", "--check")
    assert code == 2 and "identify.noise = 'floor'" in said and said.count("\n") == 1


def test_how_a_file_was_read_is_printed(here, capsys):
    lines = (here / "unit.csv").read_text().replace("angle [deg],error [arcsec]", 'Angle (°),Error (")')
    (here / "odd.txt").write_text("# bench 3\n" + lines)
    code, out, _ = run(capsys, "unit.toml", "odd.txt", "--check")
    assert code == 0 and "odd.txt: the header is line 2; the lines before it are not read" in out
    assert "'Angle (°)' as angle in deg, 'Error (\")' as error in arcsec" in " ".join(out.split())


def test_a_curve_that_no_part_can_make_is_rejected(here, undrawn, capsys):
    """An order 80 of 60 arcsec that is alike both ways: play makes opposite ones."""
    angle, error = turn(np.random.default_rng(1), 1)
    more = (angle, error + 60 * np.cos(80 * angle * deg))
    back = turn(np.random.default_rng(2), -1)
    (here / "odd.csv").write_text(
        table([(more, "forward"), ((back[0], back[1] + 60 * np.cos(80 * back[0] * deg)), "backward")])
    )
    code, out, _ = run(capsys, "unit.toml", "odd.csv", "--format", "json", "--results", "odd")
    found = json.loads(out)
    assert code == 1 and found["status"] == "REJECTED" and found["adequate"] is False
    assert found["fit"]["p_model"] < 1e-3 and any("080" in name for name in found["fit"]["worst"])
    assert "cannot explain the data" in (here / "odd" / "summary.txt").read_text()


def test_a_throw_out_of_tolerance_is_told_from_a_wrong_model(here, undrawn, capsys):
    wrong = THROW + np.array([[40.0, 0.0], [0.0, 0.0]]) * um
    (here / "broken.csv").write_text(both(np.random.default_rng(3), throw=wrong))
    code, out, _ = run(capsys, "unit.toml", "broken.csv", "--json", "--results", "broken")
    found = json.loads(out)
    assert code == 0 and found["fit"]["p_prior"] < 1e-3 < found["fit"]["p_model"]
    assert found["broken"]["crank_eccentricity[0,0]"] > 0.5 > found["broken"]["bearing_clearance"]
    assert "something is out of tolerance" in (here / "broken" / "summary.txt").read_text()


@pytest.mark.long  # test_identify_many.py has units in a batch
def test_several_units_share_a_question(here, capsys):
    rng = np.random.default_rng(5)
    tables = [both(rng, unit=name, throw=s * THROW) for name, s in (("A", 1), ("B", -1), ("C", 0))]
    (here / "lot.csv").write_text(tables[0] + "".join(t.split("\n", 1)[1] for t in tables[1:]))
    code, out, said = run(capsys, "unit.toml", "lot.csv", "--json", "--results", "lot")
    assert said == ""
    found = json.loads(out)
    assert code == 0 and list(found["units"]) == ["A", "B", "C"]
    for name, scale in (("A", 1), ("B", -1), ("C", 0)):
        value = found["units"][name]["value"]
        cells = [value[f"crank_eccentricity[{i},{j}]"] for i, j in np.ndindex(2, 2)]
        bound = 4 * 4 * catalogue.RV_40E.cranks.circle_radius * NOISE / np.sqrt(4)
        assert abs(cells[0] - cells[1] - cells[2] + cells[3] - scale * KNOWN * um) < bound
    with (here / "lot" / "units.csv").open(newline="") as file:
        rows = {row.pop("unit"): row for row in csv.DictReader(file)}
    assert [rows[name].pop("status") for name in "ABC"] == ["CONVERGED"] * 3
    for name, row in rows.items():
        numbers = {key: float(cell) for key, cell in row.items()}  # every cell is a number, its unit in the header
        for key, end in (("value", ""), ("lower", " lower"), ("upper", " upper")):
            expected = found["units"][name][key]["bearing_clearance"] / um
            assert numbers[f"bearing_clearance{end} [um]"] == pytest.approx(expected, rel=1e-9)
        assert numbers["p model"] == pytest.approx(found["units"][name]["fit"]["p_model"], rel=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[40, 80]", "[40, 40]"), "identify.orders = [40, 40]: names an order twice"),
        (("[40, 80]", "[0]"), "identify.orders = 0: must be an integer of at least 1"),
        (("[40, 80]", "[400]"), "identify.orders: order 400 is crank order 10, too fine for conditions.angles = 16"),
        (("[40, 80]", "40"), "identify.orders = 40: must be a list"),
        (("orders = [40, 80]\n", ""), "identify.orders is missing"),
        (('"floor"', '"3 um"'), "identify.noise = '3 um': unit 'um' is not one of rad, deg, arcmin, arcsec"),
        (('"floor"', '"-1 arcsec"'), "identify.noise = '-1 arcsec': must be positive"),
        (('noise = "floor"\n', ""), 'identify.noise is missing: "floor", or the standard deviation'),
        (('"four_bar"', '"six_bar"'), "identify.model = 'six_bar': must be one of four_bar, dynamics, loaded"),
        (('"four_bar"', '"loaded"'), "identify.model = 'loaded': the design has no stiffness and no contact"),
        (('["offset",', '["ofset",'), "identify.nuisance = 'ofset' (did you mean offset?): must be one of offset"),
        (('["offset",', '["reading",'), "identify.nuisance = 'reading': no observation of model 'four_bar'"),
        (("nuisance =", "shared = [\"ring\"]\nnuisance ="), "identify.shared = 'ring': must be one of crank_ecc"),
        (("nuisance =", "unknown.speed = {}\nnuisance ="), "identify.unknown.speed: no number of this design"),
        (
            ("nuisance =", 'unknown.bearing_stiffness = {lower = "1 um", upper = "2 um"}\nnuisance ='),
            "identify.unknown.bearing_stiffness.lower = '1 um': unit 'um' is not one of N/m, N/mm",
        ),
        (("nuisance =", "turns = 3\nnuisance ="), "unknown key identify.turns; known here: directions, model"),
        (("[identify]", "[columns]\nerror = \"TE\"\n[identify]"), "columns.error = 'TE': no column of the file"),
        (("output_torque", "input_torque"), "unknown key conditions.input_torque"),
        (("[identify]", "[identity]"), "unknown key [identity]"),
    ],
)  # fmt: skip
def test_a_bad_study_is_said_in_one_line(here, capsys, change, message):
    assert change[0] in STUDY
    (here / "bad.toml").write_text(STUDY.replace(*change))
    code, out, said = run(capsys, "bad.toml", "unit.csv")
    assert code == 2 and out == "" and said.count("\n") == 1 and message in said


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("frequency [Hz]\n100\n", "holds frequencies; identify.model = 'four_bar' takes curve"),
        ("angle [deg],error [arcsec]\n" + "".join(f"{a},1\n" for a in range(0, 361, 8)), "a gap of 8 deg in the angle"),
        ("angle [deg],error [arcsec]\n" + "".join(f"{a},1\n" for a in range(300)), "covers 300 deg"),
        ("angle [deg],error [arcsec]\n" + "".join(f"{a},0\n" for a in range(361)), "noise floor is 0 arcsec"),
    ],
)
def test_bad_data_is_said_in_one_line(here, capsys, data, message):
    (here / "bad.csv").write_text(data)
    code, out, said = run(capsys, "unit.toml", "bad.csv")
    assert code == 2 and out == "" and said.count("\n") == 1 and message in said


def test_refusals_of_the_command(here, capsys):
    assert "no data: name at least one CSV file" in run(capsys, "unit.toml")[2]
    assert "--results unit.csv: exists already" in run(capsys, "unit.toml", "unit.csv", "--results", "unit.csv")[2]
    assert "none.csv: no such data file" in run(capsys, "unit.toml", "none.csv")[2]
    assert 'at least model = "four_bar" or "dynamics" or "loaded", orders' in run(capsys, "rv-40e", "unit.csv")[2]
    assert 'at least model = "loaded", orders' in run(capsys, "cycloidal-17", "unit.csv")[2]
    assert "no model of an oscillatory roller reducer can be measured" in run(capsys, "corr", "unit.csv")[2]
    assert cli.main(["allocate", "unit.toml"]) == 2
    assert "unit: [requirement] is missing or empty" in capsys.readouterr().err


TONES = """
[design]
base = "rv-320e"
[tolerances.sun_planet_stiffness]
lower = -0.2
upper = 0.2
[identify]
model = "dynamics"
noise = "floor"
unknown.disc_pin_mesh = { lower = "5e8 N/m", upper = "2.5e9 N/m" }
"""


@pytest.mark.long
def test_frequencies_tell_a_stiffness(here, capsys):
    """Three modes of an RV-320E that lean on the meshes, stiffer than nominal; no two modes change places."""
    design, sd = catalogue.RV_320E, 0.5
    (here / "tones.toml").write_text(TONES)
    stiffer = design.replace(
        stiffness=design.stiffness.replace(disc_pin_mesh=1.3e9, sun_planet_mesh=1.05 * design.stiffness.sun_planet_mesh)
    )
    frequency = np.asarray(rvjax.dynamics.modes(stiffer).frequency)
    nominal = np.asarray(rvjax.dynamics.modes(design).frequency)
    moved = np.abs(np.log(np.maximum(frequency, 1e-9) / np.maximum(nominal, 1e-9))) * (frequency > 0) * (nominal > 0)
    chosen = np.sort(frequency[np.argsort(-moved)[:3]])
    (here / "tones.csv").write_text("frequency [Hz],sd [Hz]\n" + "".join(f"{f},{sd}\n" for f in chosen))
    code, out, _ = run(capsys, "tones.toml", "tones.csv", "--json", "--results", "tones")
    found = json.loads(out)
    assert code == 0 and found["adequate"] and found["next"] is None
    assert found["lower"]["disc_pin_mesh"] <= 1.3e9 <= found["upper"]["disc_pin_mesh"]
    assert found["unit"] == {"disc_pin_mesh": "N/m", "sun_planet_stiffness": "-"}
    assert found["resolution"]["disc_pin_mesh"] > 0.9
