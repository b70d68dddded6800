"""README, docs and CLI texts use the terms of the field: private words must not come back."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PRIVATE = re.compile(
    r"\b(anew|dear|doors?|rooms?|nobody|whoever|whatever|swallow\w*|bef[ae]ll?\w*|beside|blind|speaks?|knows?|own(s|ers?)"
    r"|ask(s|ed)?|stands?|worth|spare[sd]?|said|tells?|told|lanes?|judge[sd]?|refuse[sd]?|snapped|slips?|picture|machine"
    r"|printed|laws?|hardly|drawn|answer(s|ed)?)\b",
    re.IGNORECASE,
)
ALLOWED = re.compile(r"contact laws?|drawn to scale|room temperature|machine-readable", re.IGNORECASE)
CODE = re.compile(r"```.*?```|<!--.*?-->|`[^`]*`|\]\([^)]*\)|\$[^$]*\$|<[^>]*>|--[a-z-]+", re.DOTALL)

UNFINISHED = {"add_a_model.md", "speed.md"}
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
PAGES = sorted(page for page in PAGES if not {"_build", "_made"} & set(page.parts))


def private_words(text):
    """Words outside code, links and formulas that the style of this project excludes."""
    return [found.group(0) for found in PRIVATE.finditer(ALLOWED.sub("", CODE.sub("", text)))]


def test_the_list_finds_a_private_word():
    assert private_words("Whoever asks `asks` the dear machine (machine-readable) [x](asks.md)") == [
        "Whoever",
        "asks",
        "dear",
        "machine",
    ]


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in UNFINISHED], ids=lambda p: str(p.relative_to(ROOT)))
def test_a_page_uses_terms_of_the_field(page):
    assert private_words(page.read_text("utf-8")) == []


def test_the_command_line_uses_terms_of_the_field():
    """All help texts."""
    files = [ROOT / "rvjax" / "cli" / "cli.toml", *(ROOT / "rvjax" / "commands").rglob("command.toml")]
    assert len(files) > 10
    for file in files:
        lines = file.read_text("utf-8").splitlines()
        assert private_words("\n".join(line for line in lines if not line.startswith("#"))) == [], file
