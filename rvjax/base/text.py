"""Text of a data file: its encoding, and the numbers in the cells of its tables.

UTF-8, UTF-16, or the old encoding in which its letters are words of a bench; decimal points or commas, separators of
thousands, missing readings.
"""

import codecs
import math
import re
from collections.abc import Iterable, Sequence
from decimal import Decimal
from pathlib import Path

from rvjax.base.words import unknown
from rvjax.units import with_unit

SCRIPTS = {
    "cp1252": "western Europe",
    "cp1250": "central Europe",
    "gb18030": "Chinese, GB 2312",
    "cp932": "Japanese, Shift-JIS",
    "euc_jp": "Japanese, EUC",
    "cp949": "Korean",
    "cp950": "Chinese, Big5",
    "cp1251": "Cyrillic",
}
"""Old encodings that are guessed, the most frequent first."""

GUESSED = "the file is not UTF-8; it is read as"
"""Begin of the note on a guess."""

_OTHER = "another one: --encoding, in Python encoding="
_SAMPLE = 200  # lines with letters beyond ASCII that decide
_SIGNS = "°′″µμ²·∙⋅・､±×℃№、。，；：（）［］｛｝【】〔〕"
_WORDS = (
    "角度誤差時間秒分回転速入力出軸正逆方向番号測定試験機減比負荷温位置伝達剛性変年月日備考単指令偏摩擦始動値最大小平均"
    "误时间转扭矩部品项目检验报告输轴反序编号测量试验机减器载传动刚变备注单目标摩电样品型结果数据"
    "零件名批外徑径檢驗報誤時間轉輸軸號編驗減載溫傳剛變備註單標電樣數據測試結"
    "각도오차시간초분회전속토크입력출축정역방향번호측험기감비부하온위치달강성변일년월고단목표지령편마찰모터값데이최대소평균틀림위"
)
_SMALL = "ß-öø-ÿœąęłńśźżćčďěňřšťžőűů"
_USUAL = re.compile(
    rf"[{_SIGNS}{_WORDS}\u3041-\u30fe\uff21-\uff5a]|ﾄﾙｸ|ｶｸﾄﾞ|ｺﾞｻ|ｼﾞｶﾝ|ｶｲﾃﾝ"
    "|(?<![A-Za-zА-Яа-яё])[А-Я]?[а-яё]{3,}(?![A-Za-zА-Яа-яё])|(?<![A-Za-zА-Яа-яё])[А-Я]{3,}(?![A-Za-zА-Яа-яё])"
    rf"|(?<=[A-Za-z])[{_SMALL}]{{1,2}}(?![{_SMALL}])|(?<![^\W\d_])(?:[À-ÖØ-ÞŁŚŻŹČŘŠŽĆŐ]|[{_SMALL}]{{1,2}})(?=[a-z])"
    "|(?<=[\\[(])Н[·∙*]?м(?=[\\])])"
)


def text_of(path: Path, encoding: str | None = None) -> tuple[str, list[str]]:
    """Content of a text file, and a note on its encoding if that is guessed.

    Args:
        path: of the file.
        encoding: a name of Python, such as "cp932"; None: UTF-8, UTF-16 or a guess.

    Raises:
        ValueError: no text, or not in this encoding.
        FileNotFoundError: there is no such file.
    """
    try:
        content = path.read_bytes()
        if encoding is not None:
            codecs.lookup(encoding)
            return content.decode(encoding), []
        if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
            return content.decode("utf-16"), []
        head = content[:400]
        if b"\0\0" not in head and 5 * head.count(0) >= 2 * len(head) > 4:  # UTF-16: about every second byte is 0
            return content.decode("utf-16-be" if head[0] == 0 else "utf-16-le"), []
        return content.decode("utf-8-sig"), []
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such data file") from None
    except LookupError:
        raise unknown(f"encoding = {encoding!r}", encoding, ["utf-8", "utf-16", *SCRIPTS]) from None
    except OSError as error:
        raise ValueError(f"{path}: cannot be read as text ({error}); save it as UTF-8") from None
    except UnicodeDecodeError as error:
        no_text = content[:2] == b"PK" or re.search(rb"[\0-\x08\x0e-\x19\x1b-\x1f]", content)
        if encoding is not None or no_text:
            hint = "; save the sheet of a workbook as CSV" if content[:2] == b"PK" else ""
            raise ValueError(f"{path}: cannot be read as text ({error}); save it as UTF-8{hint}") from None
    for guess in _guesses(content):
        try:
            return content.decode(guess), [f"{GUESSED} {guess} ({SCRIPTS[guess]}); {_OTHER}"]
        except UnicodeDecodeError:
            continue
    return content.decode("latin-1"), [f"{GUESSED} latin-1; {_OTHER}"]


def guessed(notes: Iterable[str]) -> list[str]:
    """Notes of `text_of` among those on a file."""
    return [note for note in notes if note.startswith(GUESSED)]


def _guesses(content: bytes) -> list[str]:
    """Encodings of a sample, from that with the largest share of usual letters on."""
    sample = b"\n".join(re.findall(rb"[^\r\n]*[\x80-\xff][^\r\n]*", content)[:_SAMPLE])
    # GB 2312 has pairs of high bytes; a degree sign of Windows is one between ASCII.
    pairs = all(len(run) % 2 == 0 and min(run) > 0xA0 for run in re.findall(rb"[\x80-\xff]+", sample))
    order = sorted(SCRIPTS, key=lambda name: name != "gb18030") if pairs else list(SCRIPTS)
    return sorted(order, key=lambda name: _strange(sample, name))


def _strange(sample: bytes, encoding: str) -> float:
    """Share of letters beyond ASCII that are no usual ones of a bench; 2 for another encoding."""
    try:
        text = sample.decode(encoding)
    except UnicodeDecodeError:
        return 2.0
    usual = sum(not char.isascii() for found in _USUAL.findall(text) for char in found)
    return 1.0 - usual / sum(not char.isascii() for char in text)


LARGEST, SMALLEST = 1e12, 1e-100  # in any unit: beyond every size of a part, below every rounding error of a zero
_GROUPS = {
    mark: rf"[-+]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?:{re.escape(point)}\d*)?" for mark, point in (",.", ".,")
}
"""{mark: number with this mark between thousands}"""


def _is_proof(text: str, mark: str) -> bool:
    """Return True if a mark can only separate thousands: it occurs twice, or before the other mark."""
    other = "." if mark == "," else ","
    return re.fullmatch(_GROUPS[mark], text) is not None and (text.count(mark) > 1 or other in text)


def has_decimal_comma(text: str) -> bool:
    """Return True if the comma of a number cannot separate thousands, as in "0,5"."""
    return re.fullmatch(r"[-+]?\d+,\d+(?:[eE][-+]?\d+)?", text) is not None and not re.fullmatch(_GROUPS[","], text)


def grouping_of(source: str, cells: Sequence[str]) -> str:
    """The mark that certainly separates thousands in some cell of a file, "" for none.

    Args:
        source: name of the file, for the message.
        cells: with numbers.

    Raises:
        ValueError: the same mark is a decimal mark elsewhere.
    """
    proofs = {mark for cell in cells if "," in cell or cell.count(".") > 1 for mark in _GROUPS if _is_proof(cell, mark)}
    for mark in sorted(proofs):
        alone = [cell for cell in cells if mark in cell and not re.fullmatch(_GROUPS[mark], cell)]
        if alone or len(proofs) > 1:
            said = f"{(alone or [cell for cell in cells if _is_proof(cell, mark)])[0][:40]!r}"
            raise ValueError(f"{source}: {said}: {mark!r} separates thousands in one cell, decimals in another")
    return next(iter(proofs), "")


def number_of(
    source: str, name: str, unit: str, row: int, cell: str, comma: bool, *, missing: bool = True, grouping: str = ""
) -> float:
    """Return the number in a cell, in the unit of the cell; NaN for an empty one.

    Args:
        source: name of the file, for the message.
        name: of the quantity.
        unit: of the cell.
        row: line of the file.
        cell: text.
        comma: whether decimals may have a comma.
        missing: "nan" is a missing reading too, as an empty cell is.
        grouping: mark that separates thousands in this file.

    Raises:
        ValueError: no number, not finite, or larger or smaller than any number of a part.
    """
    text = cell.lower() if cell.isascii() and not ("," in cell or grouping) else _usual(cell, comma, grouping)
    if text == "" or (missing and text == "nan"):
        return math.nan
    where = f"{source}: row {row}, {name} = {cell[:40]!r}"
    try:
        value = float(text)
    except ValueError:
        try:
            value = float(text := _usual(cell, comma, grouping))
        except ValueError:
            hint = "; is its comma decimal? write a point, or no separator" if re.fullmatch(_GROUPS[","], text) else ""
            hint = "; save the values, not the formulas" if text.startswith("=") else hint
            raise ValueError(f"{where}: must be a number in {unit}{hint}") from None
    digits = re.search("[1-9]", text.partition("e")[0])
    if math.isnan(value) or (math.isinf(value) and not digits):
        raise ValueError(f"{where}: must be finite, in {unit}; leave the cell empty if nothing was measured")
    if abs(value) > LARGEST:
        raise ValueError(f"{where}: too large, must be at most {with_unit(LARGEST, unit, 'g')}; correct the number")
    if digits and abs(value) < SMALLEST:  # also one that is 0 in double precision
        least = with_unit(SMALLEST, unit, "g")
        raise ValueError(f"{where}: too small, must be 0 or at least {least}; correct the number")
    return value


def last_digit(cells: Sequence[str], comma: bool, grouping: str = "") -> float:
    """Return one unit of the last digit, in the unit of cells that `number_of` has read; inf without a number.

    Args:
        cells: texts.
        comma: whether decimals may have a comma.
        grouping: mark that separates thousands in this file.
    """
    parts = [text for cell in cells if (text := _usual(cell, comma, grouping)) not in ("", "nan")]
    tens = [Decimal(text).as_tuple().exponent for text in parts]
    return min((10.0**place for place in tens if isinstance(place, int)), default=math.inf)


def _usual(cell: str, comma: bool, grouping: str) -> str:
    """A number with a decimal point and without separators of thousands."""
    text = cell.lower().replace("\u2212", "-")  # the minus sign of a typesetter
    text = re.sub(r"(?<=\d)['’\u00a0\u2009\u202f ](?=\d{3}(?!\d))", "", text)
    mark = grouping or next((own for own in _GROUPS if _is_proof(text, own)), "")
    if mark and re.fullmatch(_GROUPS[mark], text):
        text = text.replace(mark, "").replace(",", ".")
    return text.replace(",", ".") if comma else text
