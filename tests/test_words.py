"""README, docs and CLI texts use the terms of the field: private words must not come back."""

import dataclasses
import io
import json
import re
import tokenize
from pathlib import Path

import pytest

from rvjax.commands import COMMANDS, inputs_of

ROOT = Path(__file__).parent.parent
PRIVATE = re.compile(
    r"\b(anew|dear|doors?|rooms?|nobody|whoever|whatever|swallow\w*|bef[ae]ll?\w*|beside|blind|speaks?|knows?|own(s|ers?)"
    r"|ask(s|ed)?|stands?|worth|spare[sd]?|said|tells?|told|lanes?|judge[sd]?|refuse[sd]?|snapped|slips?|picture|machine"
    r"|printed|laws?|hardly|drawn|answer(s|ed)?)\b",
    re.IGNORECASE,
)
ALLOWED = r"contact laws?|scaling laws?|drawn to scale|drawn cup|room temperature|machine-readable|wire-cut, printed"
ALLOWED = re.compile(ALLOWED, re.IGNORECASE)
CODE = re.compile(r"```.*?```|<!--.*?-->|`[^`]*`|\]\([^)]*\)|\$[^$]*\$|<[^>]*>|--[a-z-]+", re.DOTALL)

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "notebooks" / "README.md"]
PAGES += [ROOT / "benchmarks" / "NOTES.md", ROOT / "benchmarks" / "census" / "NOTES.md"]
PAGES += (ROOT / "docs").rglob("*.md")
PAGES = sorted(page for page in PAGES if not {"_build", "_made"} & set(page.parts))


def private_words(text):
    """Words outside code, links and formulas that the style of this project excludes."""
    return [found.group(0) for found in PRIVATE.finditer(ALLOWED.sub("", CODE.sub("", text)))]


def test_the_list_finds_a_private_word():
    assert private_words("Whoever asks `asks` dear") == ["Whoever", "asks", "dear"]
    assert private_words("machine (machine-readable) [x](asks.md)") == ["machine"]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_page_uses_terms_of_the_field(page):
    assert private_words(page.read_text("utf-8")) == []


def test_the_command_line_uses_terms_of_the_field():
    """All help texts."""
    assert private_words((ROOT / "rvjax" / "cli.toml").read_text("utf-8")) == []
    assert len(COMMANDS) > 10
    for name, line in COMMANDS.items():
        inputs = inputs_of(name)
        texts = [line, inputs.__doc__, *(field.metadata["parser"]["help"] for field in dataclasses.fields(inputs))]
        assert private_words("\n".join(texts)) == [], name


LONGEST = 25  # words of a sentence
NOT_TEXT = re.compile(r"```.*?```|<!--.*?-->|^( {4}|\t|\||#|:::).*?$", re.DOTALL | re.MULTILINE)
TERM = re.compile(r"\$\$.*?\$\$|\$[^$]*\$|`[^`]*`", re.DOTALL)  # counts as one word, which may begin a sentence
END = re.compile(r"(?<=[.!?:;])\s+(?=[A-Z\[*(\"])|[:;]\s+")


def long_sentences(text):
    """Sentences, or parts of one up to a colon or semicolon, of more than `LONGEST` words; without tables and code."""
    text = re.sub(r"\]\([^)]*\)", "]", TERM.sub("Term", NOT_TEXT.sub("\n\n", text)))
    parts = [part for whole in re.split(r"\n\s*\n|\n\s*(?=[-*] |\d+\. )", text) for part in END.split(whole)]
    return [" ".join(part.split()) for part in parts if len(re.findall(r"[A-Za-z0-9][^\s]*", part)) > LONGEST]


def test_a_long_sentence_is_found():
    short, long = "one " * LONGEST + "`code`. Next one; ", "word " * (LONGEST + 1)
    assert long_sentences(short.replace("one ", "", 1)) == []
    assert long_sentences(f"{short}\n\n- item\n- {long}\n\n| {long} |") == [
        f"{short.split('.')[0][:-6]}Term.",
        "- " + long.strip(),
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_a_page_has_short_sentences(page):
    assert long_sentences(page.read_text("utf-8")) == []


BLOCK = re.compile(r"^ *(```|:::).*?^ *\1$|<!--.*?-->|^( {4}|\|).*?$", re.DOTALL | re.MULTILINE)


def test_the_docs_are_short():
    """Words of all pages, without blocks of code, equations, tables and comments."""
    texts = [BLOCK.sub("", page.read_text("utf-8")) for page in PAGES if ROOT / "docs" in page.parents]
    assert 10_000 < sum(len(text.split()) for text in texts) <= 20_000


PLAIN = [pytest.param("rvjax", marks=pytest.mark.long), "tests/oracles", "benchmarks", "docs"]  # the first: a job
"""Folders whose comments, docstrings and messages use the terms of the field."""
NAMES = re.compile(r"^\s+\w+: |\b[A-Z][A-Z_]+\b|\{[^{}]*\}|^[rf]*['\"][\w.]*(?: \| \w+)*['\"]$", re.MULTILINE)
"""Arguments, constants, expressions, keys."""
KEYS = re.compile(r"^([\w.]+ *=|\[.*\])", re.MULTILINE)
RIDDLE = re.compile(r"\"\"\"(What|Who|Whose|Whether|Which|Where|When|Why|How)\b[^\n]*")
TEXTS = {tokenize.COMMENT, tokenize.STRING, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}


def private_lines(source):
    """Lines of Python whose comments or strings have private words or riddles, with these."""
    found = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in TEXTS:
            words = private_words(NAMES.sub("", token.string)) + [m.group(0) for m in RIDDLE.finditer(token.string)]
            found += [(token.start[0], word) for word in words]
    return found


def test_private_words_of_python_are_found_in_texts_only():
    source = 'def law(lane):\n    """What it does.\n\n    lane: drawn.\n    """\n    f"{lane} asked", "law"  # dear'
    assert private_lines(source) == [(2, "drawn"), (2, '"""What it does.'), (6, "asked"), (6, "dear")]


@pytest.mark.parametrize("name", PLAIN)
def test_comments_and_docstrings_use_terms_of_the_field(name):
    files = sorted((ROOT / name).rglob("*.py")) or [ROOT / name]
    texts = {str(file.relative_to(ROOT)): file.read_text("utf-8") for file in files}
    assert {file: found for file, text in texts.items() if (found := private_lines(text))} == {}


@pytest.mark.parametrize("name", ["catalogue.toml", "published", "study"])
def test_comments_and_values_of_tables_use_terms_of_the_field(name):
    """TOML files of reducers, published values and embedded studies; their keys are names."""
    place = ROOT / "rvjax" / name
    texts = {file.name: file.read_text("utf-8") for file in [place, *place.rglob("*.toml")] if file.is_file()}
    assert texts
    assert {file: found for file, text in texts.items() if (found := private_words(KEYS.sub("", text)))} == {}


def test_the_table_of_mutants_uses_terms_of_the_field():
    lines = (ROOT / "benchmarks" / "census" / "mutants.toml").read_text("utf-8").splitlines()
    assert private_words("\n".join(line for line in lines if line.startswith(("breaks = ", "#")))) == []


@pytest.mark.parametrize("notebook", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda p: p.stem)
def test_a_notebook_uses_terms_of_the_field(notebook):
    found = []
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        text = "".join(cell["source"])
        found += private_words(text) if cell["cell_type"] == "markdown" else private_lines(text)
    assert found == []
