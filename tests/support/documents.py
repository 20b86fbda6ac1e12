"""Reads the Markdown documentation: its files, links, anchors and code blocks."""

import re

from tests.support.sources import CHECKOUT

DOCUMENTS = sorted(
    path
    for path in (*CHECKOUT.glob("*.md"), *(CHECKOUT / "docs").rglob("*.md"))
    if path.is_file()
)
_LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
_BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def read(name: str) -> str:
    """The text of a document, by its path from the top of the checkout."""
    return (CHECKOUT / name).read_text("utf-8")


def without_code(text: str) -> str:
    """The text without code: what looks like a link in code is none."""
    return re.sub(r"`[^`\n]+`", "", _BLOCK.sub("", text))


def links(text: str) -> list[str]:
    """The targets of all links and images of a document."""
    return _LINK.findall(without_code(text))


def anchors(text: str) -> set[str]:
    """The anchors that a document's headings get."""
    titles = re.findall(r"^#+ (.+)$", _BLOCK.sub("", text), re.MULTILINE)
    return {
        re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-")
        for title in titles
    }


def blocks(text: str, language: str) -> list[str]:
    """The contents of the code blocks that are marked with a language."""
    return [code for tag, code in _BLOCK.findall(text) if tag == language]


def names_in_rows(text: str, heading: str) -> list[list[str]]:
    """The names in code style in the first cell of each row of a section's tables.

    Parameters
    ----------
    text : str
        A Markdown document.
    heading : str
        The heading of the section, with its number signs: ``"## What is stored"``.
    """
    section = text.partition(f"\n{heading}\n")[2]
    rows = re.findall(r"^\| (`.+?`) \|", re.split(r"\n#+ ", section)[0], re.MULTILINE)
    return [re.findall(r"`(.+?)`", row) for row in rows]
