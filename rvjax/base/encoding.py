"""Encoding of a text file: UTF-8, UTF-16, or the old encoding in which its letters are words of a bench."""

import codecs
import re
from collections.abc import Iterable
from pathlib import Path

from rvjax.base.words import unknown

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
            return content.decode(guess), [
                f"{GUESSED} {guess} ({SCRIPTS[guess]}); another one: --encoding, in Python encoding="
            ]
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
