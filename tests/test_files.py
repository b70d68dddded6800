"""Files as people have them: many spellings are one table, every other file has a message that names its columns.

Oracle: the numbers from which the files are written.
"""

import re

import numpy as np
import pytest

from rvjax import cli, measured, study
from rvjax.base.cells import read_cells
from rvjax.commands.compensate import corrections
from rvjax.designs import RVReducer
from rvjax.measured import read_table
from rvjax.render import as_csv
from rvjax.tolerances import measured as measured_parts
from rvjax.units import arcsec, deg, rpm, um

ANGLE, ERROR = [0.5, 1.5, 2.5], [-1.25, 2.0, 3.0]
PLAIN = "angle [deg],error [arcsec]"


def rows(between=",", point=".", after=""):
    lines = (f"{a}{between}{e}".replace(".", point) for a, e in zip(ANGLE, ERROR))
    return "".join(f"{line}{after}\n" for line in lines)


def same(path, columns=None, kind=None):
    found = measured.read([path], columns, kind=kind)
    (run,) = found.runs
    np.testing.assert_allclose(run.angle, np.multiply(ANGLE, deg), rtol=1e-14)
    np.testing.assert_allclose(run.error, np.multiply(ERROR, arcsec), rtol=1e-14)
    return found


def message(path, columns=None):
    with pytest.raises(ValueError, match=re.escape(path.name)) as caught:
        measured.read([path], columns)
    assert "\n" not in str(caught.value)
    return str(caught.value).replace(f"{path}: ", "")


HEADERS = [
    "angle (deg),error (arcsec)",
    "angle（deg）,error（arcsec）",
    "angle【deg】,error［arcsec］",
    "Angle[deg],ERROR {ArcSec}",
    "Angle_deg,Error_arcsec",
    "angle/deg,error/arcsec",
    "angle in deg,error - arcsec",
    "angle deg,error arcsec",
    "angle°,error″",
    'Angle [°],Error ["]',
    '"Angle (°)","Error (\'\')"',
    '"angle, deg","error, arcsec"',
    "Angle (deg):,Error (arc-sec):",
    '"angle\n[deg]","error\n[arcsec]"',
    "anGLE [degrees],error [asec]",
]


@pytest.mark.parametrize("header", HEADERS)
def test_a_header_may_have_any_brackets_capitals_and_symbols(write, header):
    same(write(f"{header}\n{rows()}"))
    same(write(f"note,{header}\n" + "".join(f"x,{line}\n" for line in rows().splitlines())))


BEFORE = [
    "# unit 17, 2026-08-01\n# operator: -\n",
    "% made by a program\n",
    "// a, b, c\n",
    "; rig 3\n;\n",
    "Date: 2026-08-01 10:00:00\nOperator: Kim\n\n",
    "Date,2026-08-01\nUnit,17\nDirection,forward\n",
    "Torque:\t412 N m\n",
    "[Header]\nsamples=3\n[Data]\n",
    "sep=,\n",
    "unit 17\n",
]


@pytest.mark.parametrize("before", BEFORE)
@pytest.mark.parametrize("between", [",", ";", "\t", "   "])
def test_lines_before_the_header_are_skipped(write, before, between):
    point = "," if between == ";" else "."
    header = PLAIN.replace(",", between)
    found = same(write(before + header + "\n" + rows(between, point)))
    assert found.notes == (
        f"bench.csv: the header is line {before.count(chr(10)) + 1}; the lines before it are not read",
    )


TABLES = {
    "header in a comment": f"# {PLAIN}\n{rows()}",
    "header in a comment, spaces": f"# angle [deg] error [arcsec]\n{rows(' ')}",
    "header and units in comments": f"% angle error\n% deg arcsec\n{rows(' ')}",
    "last line of words": f"{PLAIN}\n{rows()}\nEnd of data\n\x1a",
    "full-width commas": f"angle（deg），error（arcsec）\n{rows('，')}",
    "full-width comma in a name": f"{PLAIN},备注，说明\n{rows(after=',好')}",
    "comments between": f"{PLAIN}\n" + rows().replace("1.5,", "# stop, then, on\n#9,9\n1.5,") + "# end\n",
    "row of units": f"angle,error\ndeg,arcsec\n{rows()}",
    "row of units in brackets": f'Angle;Error\n[°];["]\n{rows(";", ",")}',
    "row of units, spaces": f"angle error\ndeg arcsec\n{rows(' ')}",
    "row of units of known ones": f"{PLAIN}\ndeg,arcsec\n{rows()}",
    "row of units with others": "t,angle,error\n(s),(deg),(arcsec)\n" + "".join(f"1,{x}\n" for x in rows().split()),
    "spaces": "".join(f"   {line}   \n" for line in ["angle [deg]    error [arcsec]", *rows("     ").split("\n")[:3]]),
    "one space": f"angle [deg] error [arcsec]\n{rows(' ')}",
    "spaces, decimal commas": f"angle[deg]  error[arcsec]\n{rows('  ', ',')}",
    "tabs and spaces": f"angle [deg] \t error [arcsec]\n{rows(chr(9) + ' ')}",
    "header with tabs, rows with spaces": f"angle [deg]\terror [arcsec]\n{rows('   ')}",
    "header with spaces, rows with tabs": f"angle [deg] error [arcsec]\n{rows(chr(9))}",
    "two tabs": f"angle [deg]\terror [arcsec]\n{rows(chr(9) * 2)}",
    "bars": f"angle [deg]|error [arcsec]\n{rows('|')}",
    "commas in the header, semicolons": f"angle, deg;error, arcsec\n{rows(';', ',')}",
    "quotes": '"angle [deg]", "error [arcsec]"\n' + "".join(f'"{a}", "{e}"\n' for a, e in zip(ANGLE, ERROR)),
    "quotes, decimal commas": f"{PLAIN}\n" + '"0,5","-1,25"\n"1,5","2"\n"2,5","3,0"\n',
    "empty last column": f"{PLAIN},\n{rows(after=',')}",
    "delimiters at the end": f"{PLAIN}\n{rows(after=',,')}",
    "delimiter at the end of the header": f"{PLAIN},\n{rows()}",
    "lines between": f"\n\n{PLAIN}\n\n" + rows().replace("\n", "\n\n"),
    "minus of a typesetter": f"{PLAIN}\n" + rows().replace("-", "−"),
    "no column of its own": ",angle [deg],error [arcsec]\n"
    + "".join(f"{k},{x}\n" for k, x in enumerate(rows().split())),
}


@pytest.mark.parametrize("text", TABLES.values(), ids=TABLES)
@pytest.mark.parametrize("ending", ["\n", "\r\n", "\r"])
def test_one_table_however_a_program_writes_it(write, text, ending):
    same(write(text.replace("\n", ending)))


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig", "cp1252", "latin-1", "gb18030"])
def test_the_degree_sign_of_any_encoding(write, encoding):
    text = "angle [°];error [arcsec];Bemerkung\n" + rows(";", ",", ";x")
    found = same(write(text.encode(encoding)))
    guessed = [note for note in found.notes if "not UTF-8" in note]
    assert bool(guessed) == (encoding in ("cp1252", "latin-1", "gb18030"))


SCRIPTS = {
    "cp932": [
        "角度（度）,誤差（秒）",
        "回転角[°],伝達誤差[″]",
        "ねじれ角,エラー",
        "角度,ﾄﾙｸ",
        "外径,項目",
    ],
    "euc_jp": ["角度[deg],誤差[秒]", "測定番号,入力角度", "減速機入力回転数,起動トルク"],
    "cp949": ["각도[deg],오차[초]", "하중 [N],변위 [mm]", "시료,각"],
    "cp950": ["角度（度）,誤差（秒）", "批號,零件名", "輸出軸扭矩,溫度"],
    "gb18030": ["角度（度）,误差（秒）", "传动误差,备注：无", "好,x", "谐波减速器,样品"],
    "cp1251": ["угол [град],ошибка [угл.сек]", "Крутящий момент [Н·м],Угол", "Дата,НОМЕР"],
    "cp1252": ["Winkel [°],Fehler [µm]", "Größe,Verzögerung", "Couple à vide,Fréquence", "Ø,± 1"],
}


@pytest.mark.parametrize("encoding", SCRIPTS)
def test_an_old_encoding_is_guessed_by_words_of_a_bench(write, encoding):
    for head in SCRIPTS[encoding]:
        text = f"{head},{PLAIN}\n" + "".join(f"0,0,{row}\n" for row in rows().split())
        table = read_table(write(text.encode(encoding)))
        assert table.header[:2] == tuple(head.split(",")), head
        assert table.notes[0].startswith(f"the file is not UTF-8; it is read as {encoding} (")


def test_the_encoding_may_be_named(write, tmp_path, capsys):
    path = write("úhel [deg];převod\n1;2\n".encode("cp1250"))
    assert "is read as cp1252 (western Europe); another one: --encoding" in message(path, {"angle": "uhel"})
    assert "is read as cp1252 (western Europe); another one: --encoding" in message(path)
    table = read_table(path, {"angle": "úhel"}, encoding="cp1250")
    assert table.header == ("úhel [deg]", "převod") and "UTF-8" not in "".join(table.notes)
    with pytest.raises(ValueError, match=r"encoding = 'cp125' .*must be one of utf-8"):
        read_table(path, encoding="cp125")
    with pytest.raises(ValueError, match=r"cannot be read as text \('ascii' codec"):
        read_table(path, encoding="ascii")
    lot = write("Größe;pin_radius [um]\n1;1,5\n2;2,5\n".encode("cp1252"))
    assert measured_parts(lot, {"pin_radius": "pin_radius"}, encoding="cp1252").columns["pin_radius"].n == 2
    (tmp_path / "reducer.toml").write_text(REDUCER.partition("[columns]")[0])
    assert cli.main(["compensate", str(tmp_path / "reducer.toml"), str(path), "--encoding", "cp125"]) == 2
    assert "encoding = 'cp125'" in capsys.readouterr().err


def test_chinese_words_of_an_old_program(write):
    text = "时间（s）,角度（°）,误差（″）,备注\n" + "".join(f"0,{line},好\n" for line in rows().split())
    for encoding in ("utf-8", "gb18030", "utf-16"):
        path = write(text.encode(encoding))
        same(path, {"angle": "角度", "error": "误差"})
        assert 'angle = { column = "角度（°）", unit = "deg" }' in message(path)


@pytest.mark.parametrize(
    "cells",
    [
        ["1,234.5", "1,235.5", "1,236.0"],
        ["1.234,5", "1.235,5", "1.236,0"],
        ["1.234,5", "1.235,5", "1.236"],  # the other cells prove what this point is
        ["1'234.5", "1’235.5", "1236"],
        ["1\u00a0234,5", "1\u202f235,5", "1 236"],
    ],
)
def test_thousands_where_no_other_reading_is_possible(write, cells):
    path = write("angle [deg];error [arcsec]\n" + "".join(f"{cell};1\n" for cell in cells))
    np.testing.assert_allclose(read_table(path).numbers["angle"] / deg, [1234.5, 1235.5, 1236.0], rtol=1e-14)


def test_a_comma_that_may_be_either_is_as_before_or_refused(write):
    path = write("angle [deg];error [arcsec]\n1,234;1\n")
    np.testing.assert_allclose(read_table(path).numbers["angle"], 1.234 * deg)
    assert "is its comma decimal?" in message(write(f'{PLAIN}\n"1,234",1\n'))
    assert "',' separates thousands in one cell, decimals in another" in message(
        write("angle [deg];error [arcsec]\n1,234.5;0,25\n")
    )


WRONG = {
    "no units": (
        "time torque angle\n0 1 2\n",
        ["column 'torque': has no unit", 'torque = { column = "torque", unit = "N m" }'],
    ),
    "log": (
        "TIME,POSITION,TORQUE\n0,1,2\n",
        ['"torque [N m]" (N m, kN m, mN m', "the file has the columns TIME, POSITION, TORQUE"],
    ),
    "names": (
        "扭矩(N·m),角度(arcmin)\n0,1\n",
        ['torque = { column = "扭矩(N·m)", unit = "N m" }', 'angle = { column = "角度(arcmin)"'],
    ),
    "slips": (
        "anlge [deg],eror [arcsec]\n1,2\n",
        ["did you mean angle for 'anlge [deg]'?", "did you mean error for 'eror [arcsec]'?"],
    ),
    "slip": ('angle [deg],eror (")\n1,2\n', ['error = { column = "eror (\\")", unit = "arcsec" }']),
    "two": (
        'angle_deg,angle (rad),error (")\n1,2,3\n',
        ["angle may be in angle_deg, angle (rad); write one in [columns]"],
    ),
    "sec": ("angle [deg],error [sec]\n1,2\n", ["unit 'sec' is not known (did you mean arcsec?)"]),
    "grad": ("angle [grad],error [arcsec]\n1,2\n", ["unit 'grad' is not known; write"]),
    "count": ("angle [count],error [arcsec]\n1,2\n", ["needs the counts per turn", "counts_per_turn = 524288 }"]),
    "a unit of another size": (
        "torque [MN m],angle [deg]\n1,2\n",
        ["unit 'MN m' is not known; write the numbers in another one", 'under "torque [N m]" (N m, kN m'],
    ),
    "a unit of another size in a foreign name": (
        "Moment [MN m],angle [deg]\n1,2\n",
        ['such as error = "Moment [MN m]"'],
    ),
    "two encoders": (
        "time [s],motor encoder [deg],output encoder [deg]\n0,1,2\n",
        ["of two encoders, the error is the angle of the output less that of the input over the ratio"],
    ),
    "formula": (f"{PLAIN}\n0.5,1\n=A2+1,2\n", ["angle = '=A2+1': must be a number in deg; save the values"]),
    "no column left": (
        "torque [N m]\n1\n",
        ["columns torque: what is needed", "the file has the columns torque [N m]"],
    ),
    "no header": ("0.5,1\n1.5,2\n", ["the first line, 0.5, 1, has numbers"]),
    "two units": (f"{PLAIN}\nrad,arcsec\n1,2\n", ["column 'angle [deg]': row 2 says 'rad'"]),
    "wide": ("target [deg],fwd1,bwd1\n0,1,2\n", ["column 'fwd1': has no unit; write \"fwd1 [arcsec]\""]),
    "wide, two targets": (
        "target [deg],nominal [deg],fwd [deg]\n0,0,0\n",
        ["the target may be in target [deg], nominal [deg]"],
    ),
    "wide, readings": ("target [deg],fwd [deg]\n0,0\n30,20\n", ["neither near the targets nor near zero"]),
}


@pytest.mark.parametrize(("text", "parts"), WRONG.values(), ids=WRONG)
def test_any_other_file_has_one_message_with_its_columns(write, text, parts):
    said = message(write(text))
    assert all(part in said for part in parts), said


def test_a_workbook_is_no_text(write):
    assert "save the sheet of a workbook as CSV" in message(write(b"PK\x03\x04\x14\x00\xff\xfe"))


def test_what_was_not_plain_is_said(write):
    log = "TIME,POSITION,TORQUE,CONTROL_TORQUE\n0,0.25,1,9\n1,0.5,2,9\n"
    columns = {"angle": {"column": "POSITION", "unit": "turn"}, "torque": {"column": "TORQUE", "unit": "N m"}}
    table = read_table(write(log), columns)
    np.testing.assert_allclose(table.numbers["angle"], [np.pi / 2, np.pi])
    assert list(table.numbers["torque"]) == [1, 2]
    (said,) = table.notes
    assert said == (
        "columns are read: 'POSITION' as angle in turn, 'TORQUE' as torque in N m; not read: TIME, CONTROL_TORQUE"
    )
    assert not same(write(f"{PLAIN},note\n{rows(after=',x')}")).notes


def test_a_suffix_that_is_no_unit_of_the_quantity_is_another_column(write):
    more = "".join(f"{line},7,8\n" for line in rows().split())
    found = same(write(f"angle_deg,error_arcsec,torque_h,angle_m\n{more}"))
    assert found.notes[0].endswith("not read: torque_h, angle_m")


def test_plain_headers_are_read_as_before_whatever_else_the_file_has(write):
    """A column in brackets that was skipped before must not split a run, nor make the file another kind."""
    more = "".join(f"{line},{k},{k},{20 + k}\n" for k, line in enumerate(rows().split()))
    found = same(write(f"{PLAIN},Torque (N m),frequency/Hz,temperature_degC\n{more}"))
    assert len(found.notes) == 3 and "column 'Torque (N m)' is not read" in found.notes[0]
    loop = read_table(write("torque [N m],angle [deg],error (deg)\n1,2,3\n"))
    assert "error" not in loop.numbers


def test_lines_that_are_skipped_are_numbered(write):
    found = same(write(f"{PLAIN}\n0.5,-1.25\n# 0.7, 9\n1.5,2\n// pause\n2.5,3\nstopped by hand\n"))
    said = "bench.csv: lines of the table that are not read"
    assert set(found.notes) == {f"{said}: 3", f"{said}: 5, 7"}
    assert "row 4 has 1 cells, the header 2" in message(write(f"{PLAIN}\n0.5,1\n1.5,2\n2.5"))  # a line that is cut


def test_a_word_may_begin_with_the_mark_of_a_comment(write):
    text = "unit,angle [deg],error [arcsec]\n" + "".join(f"#17,{line}\n" for line in rows().split())
    assert same(write(text)).units == ["#17"]


def test_counts_are_angles_if_the_counts_of_a_turn_are_known(write):
    path = write("enc,ref\n131072,10\n")
    counts = {"column": "enc", "unit": "counts", "counts_per_turn": 524288}
    table = read_table(path, {"angle": counts, "error": counts | {"column": "ref", "counts_per_turn": 1_296_000}})
    np.testing.assert_allclose([table.numbers[n][0] for n in ("angle", "error")], [90 * deg, 10 * arcsec], rtol=1e-14)
    for wrong in (0, -1, True, "524288", float("inf")):
        with pytest.raises(ValueError, match=r"columns.angle.counts_per_turn = .*: must be a positive number"):
            read_table(path, {"angle": counts | {"counts_per_turn": wrong}})
    with pytest.raises(ValueError, match="belongs to unit = \"count\", not 'deg'"):
        read_table(path, {"angle": counts | {"unit": "deg"}})
    with pytest.raises(ValueError, match="unit 'count' is not known"):
        read_table(path, {"torque": {"column": "enc", "unit": "count"}})


def test_columns_are_named_without_regard_to_capitals_and_brackets(write):
    path = write("Enc Pos (gon),Speed [1/min],error [arcsec]\n100,15,1\n")
    table = read_table(path, {"angle": "enc_pos"})
    np.testing.assert_allclose(table.numbers["angle"], 90 * deg)
    np.testing.assert_allclose(table.numbers["speed"], 15 * rpm)
    assert "columns.angle = 'enc': no column of the file" in message(path, {"angle": "enc"})
    assert "(did you mean Enc Pos (gon)?)" in message(path, {"angle": "Enc Poz (gon)"})
    with pytest.raises(ValueError, match=r"columns.torque = 'enc pos': is the column of angle too"):
        read_table(path, {"angle": "enc_pos", "torque": "enc pos"})


REDUCER = """
[design]
base = "rv-40e"

[columns]
angle = { column = "enc", unit = "count", counts_per_turn = 1440 }
"""


def test_a_study_of_the_reducer_alone_compensates(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "reducer.toml").write_text(REDUCER)
    angle = np.arange(1440)
    error = 10 * np.cos(40 * angle * 2 * np.pi / 1440) + np.random.default_rng(0).normal(0, 0.1, 1440)
    (tmp_path / "curve.csv").write_text(
        "enc,error (arcsec)\n" + "".join(f"{a},{e!r}\n" for a, e in zip(angle, error.tolist()))
    )
    asked = study.load("reducer.toml", solve=False, needs=("design",))
    assert isinstance(asked.design, RVReducer) and not asked.requirements and not asked.fields
    (curve,) = corrections(asked, "curve.csv").curves
    assert list(curve.correction.order) == [40]
    np.testing.assert_allclose(curve.correction.value, [10 * arcsec], rtol=2e-3)
    assert cli.main(["compensate", "reducer.toml", "curve.csv", "--export", "t.csv"]) == 0
    assert "columns are read: 'enc' as angle in count, 'error (arcsec)' as error in arcsec" in capsys.readouterr().out
    for command in (["allocate"], ["check"], ["identify", "curve.csv"], ["montecarlo"], ["budget"]):
        assert cli.main([command[0], "reducer.toml", *command[1:]]) == 2
        assert "reducer: [tolerances] is missing or empty" in capsys.readouterr().err
    (tmp_path / "nothing.toml").write_text("[about]\ntitle = 'x'\n")
    assert cli.main(["compensate", "nothing.toml", "curve.csv"]) == 2
    assert "nothing: [design] is missing or empty" in capsys.readouterr().err


@pytest.mark.parametrize("said", ["kN m", "ozf in", "gf·cm", "kg cm", "N･cm"])
def test_the_unit_of_a_header_and_another_one_in_columns_are_refused(write, said):
    path = write(f"torque [{said}],angle [deg]\n1,2\n")
    with pytest.raises(ValueError, match=rf"columns.torque.unit = 'N m': the header says '{said}'; remove one"):
        read_table(path, {"torque": {"column": f"torque [{said}]", "unit": "N m"}})
    same_unit = read_table(path, {"torque": {"column": "torque", "unit": said}})
    assert same_unit.numbers["torque"] == read_table(path).numbers["torque"]


def test_a_comma_in_the_brackets_of_a_header_needs_no_quotes(write):
    text = "kind,id,disc_bore[0,1] [um],disc_bore[1,0] [um],note (a, (b, c)),x)\ndisc,a,1,2,n,y\n"
    plain = read_cells(write(text))
    quoted = 'kind,id,"disc_bore[0,1] [um]","disc_bore[1,0] [um]","note (a, (b, c))",x)\ndisc,a,1,2,n,y\n'
    assert (plain.header, plain.body) == (read_cells(write(quoted)).header, [(2, ["disc", "a", "1", "2", "n", "y"])])
    lot = measured_parts(write("disc_bore[0,0] [um];disc_bore[0,1] [um]\n1;2\n3;4\n".replace(";", ",")))
    assert list(lot.columns) == ["disc_bore[0,0]", "disc_bore[0,1]"]


def test_no_text_of_a_result_is_a_formula():
    rows = [["=1+1", 1.5], ["@SUM(A1)", None], ["+- 0.2 arcsec", -2.0], ["-", "-"], ["-1.5", "+2e-3"], ["a=b", "-x"]]
    lines = as_csv(["name", "=value"], rows).decode().split("\n")[:-1]
    assert lines == ["name,'=value", "'=1+1,1.5", "'@SUM(A1),", "'+- 0.2 arcsec,-2.0", "-,-", "-1.5,+2e-3", "a=b,'-x"]


def test_a_row_of_very_many_columns_is_one_message(write):
    for text in (
        ",".join(["1"] * 200_000),
        ",".join(f"c{k} [deg]" for k in range(200_000)),
        " ".join(["x"] * 200_000),
    ):
        assert message(write(text)) == "200000 columns, at most 10000; a table has a row for each reading"


def test_measured_parts_have_units_in_any_brackets(write):
    lot = write("# lot 7\nTeil;pin_radius (µm);crank phase\n1;1,5;0\n2;2,5;1\n3;3,5;3\n")
    found = measured_parts(lot)
    assert list(found.columns) == ["pin_radius"] and found.columns["pin_radius"].mean.value == pytest.approx(2.5 * um)
    mixed = measured_parts(write("pin_radius [um],crank_phase (mrad)\n1,0\n2,1\n"))
    assert list(mixed.columns) == ["pin_radius"]  # a plain header is there: as before
    turns = {"crank_phase": {"column": "enc", "unit": "count", "counts_per_turn": 1000}}
    counted = measured_parts(write("enc\n1\n3\n"), turns).columns["crank_phase"]
    assert counted.unit == "rad" and counted.mean.value == pytest.approx(2 * 2 * np.pi / 1000)
