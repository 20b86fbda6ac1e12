"""How often the code uses `Any` or `cast`, or silences a tool; each has a maximum.

The maxima are only ever lowered.
"""

from __future__ import annotations

import io
import re
import tokenize
from typing import Final

import pytest

from tests.support.sources import PYTHON, python_sources

MOST: Final = {"app": 26, "filter_core": 9, "unghost": 16}
"""The number of `Any`, `cast`, ``type: ignore`` and ``noqa`` in each package."""
_WORDS: Final = frozenset({"Any", "cast"})
_REMARK: Final = re.compile(r"\b(?:type: ignore|noqa)\b")
_WITH_REASON: Final = re.compile(r"(?:# (?:type: ignore\[.+?\]|noqa: [\w, ]+) +)+# \S")


@pytest.mark.parametrize("package", MOST)
def test_number_of_type_escapes_equals_its_maximum(package):
    found = {
        source.name: count_escapes(source.text) for source in python_sources(package)
    }
    count = sum(found.values())

    most = sorted(found, key=lambda name: -found[name])[:5]
    assert count <= MOST[package], f"{count}, most of them in {', '.join(most)}"
    assert count == MOST[package], f"only {count} are left: lower MOST"


def count_escapes(text: str) -> int:
    """How often a text uses `Any` or `cast` (imports aside) or silences a tool."""
    if not (_REMARK.search(text) or any(word in text for word in _WORDS)):
        return 0  # quicker than reading the tokens
    count = 0
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        is_import = token.line.lstrip().startswith(("from ", "import "))
        if token.type == tokenize.NAME and token.string in _WORDS and not is_import:
            count += 1
        elif token.type == tokenize.COMMENT:
            count += len(_REMARK.findall(token.string))
    return count


@pytest.mark.parametrize("folder", PYTHON)
def test_every_silenced_tool_warning_has_a_reason(folder):
    """A comment gives the reason; mypy and ruff check that it names the rule."""
    silent = [
        f"{source.name}: {comment}"
        for source in python_sources(folder)
        for comment in comments(source.text)
        if _REMARK.search(comment) and not _WITH_REASON.match(comment)
    ]

    assert silent == []


def comments(text: str) -> list[str]:
    """The comments of a module; none if no word of it could silence a tool."""
    if not _REMARK.search(text):  # quicker than reading the comments
        return []
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return [token.string for token in tokens if token.type == tokenize.COMMENT]


def test_escapes_are_counted():
    text = (
        "from typing import Any, cast\n"
        "one: Any = cast('int', two)  # type: ignore[misc]  # noqa: E501\n"
        "Anything = 'Any'  # of any kind\n"
    )

    assert count_escapes(text) == 4
