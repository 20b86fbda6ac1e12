"""The page's modules in two scripts, as each module would be a request of its own.

A pack has the text of its modules without comments, each in a function that returns
what the module exports, after those of the modules that it imports. It takes neither a
build nor a parser, as modules import and export in few forms: see the patterns below.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

ENTRY: Final = "js/main.js"
FIRST: Final = "first.js"
"""The pack that starts the page: the way to the first answer (`_FIRST_VIEWS`)."""
LATER: Final = "later.js"
"""The pack of all other modules, fetched when a view needs one of them."""
_OWN: Final = "js/"
_FIRST_VIEWS: Final = (
    "js/datasets/home.js",
    "js/queue/queue.js",
    "js/grid/grid.js",
    "js/review/frame.js",
)
_IMPORT: Final = re.compile(
    r'^import\s*(?:(\w+)|\{([^}]*)\})\s*from\s*"(\.[^"]+)";?', re.MULTILINE
)
_LATER_IMPORT: Final = re.compile(r'\bawait import\("(\.[^"]+)"\)')
_EXPORT: Final = re.compile(
    r"^export (?=(?:async )?(?:function\*?|class|const) (\w+))", re.MULTILINE
)
_EXPORT_LIST: Final = re.compile(r"export ?\{([^}]*)\};?")
_EXPORT_DEFAULT: Final = "export default "
_COMMENT: Final = re.compile(
    r"^[ \t]*(?://.*|/\*\*[^*]*(?:\*(?!/)[^*]*)*\*/[ \t]*)\n", re.MULTILINE
)
_UNKNOWN_FORM: Final = re.compile(r"^(?:import|export)\b(?!\()", re.MULTILINE)


def packs_of(folder: Path) -> dict[str, bytes]:
    """The two packs of the page in this folder, by name.

    Raises ValueError: a module imports itself by way of others, or imports or exports
    in a form that is not known here.
    """
    texts = {}
    for path in sorted((*folder.glob("js/**/*.js"), *folder.glob("vendor/*.js"))):
        name, text = path.relative_to(folder).as_posix(), path.read_text("utf-8")
        # In those of others, the licences are comments.
        texts[name] = _COMMENT.sub("", text) if name.startswith(_OWN) else text
    imports = {name: _imported(name, text, _IMPORT) for name, text in texts.items()}
    awaited = [
        other
        for name, text in texts.items()
        for other in _imported(name, text, _LATER_IMPORT)
    ]
    first = in_order(imports, (*_FIRST_VIEWS, ENTRY))
    later = in_order(imports, (*first, *awaited))[len(first) :]
    numbers = {name: f"${number}" for number, name in enumerate((*first, *later))}
    shared = {other for name in later for other in imports[name]}
    listed = ", ".join(numbers[name] for name in first if name in shared)
    own = ", ".join(numbers[name] for name in later)
    blocks = {
        name: _block(name, texts[name], numbers, frozenset(first)) for name in numbers
    }
    packs = {
        FIRST: (*(blocks[name] for name in first), f"export {{ {listed} }};"),
        LATER: (
            f'import {{ {listed} }} from "./{FIRST}";',
            *(blocks[name] for name in later),
            f"export {{ {own} }};",
        ),
    }
    return {name: "\n".join((*lines, "")).encode() for name, lines in packs.items()}


def in_order(imports: Mapping[str, Iterable[str]], entries: Iterable[str]) -> list[str]:
    """The entries and all modules that they import, each after those it imports.

    Modules that are loaded later, by ``import()``, are left out.
    """
    ordered: dict[str, None] = {}
    above: list[str] = []

    def visit(name: str) -> None:
        if name in above:
            raise ValueError(f"{name} imports itself by way of {above[-1]}")
        if name in ordered:
            return
        above.append(name)
        for imported in imports[name]:
            visit(imported)
        above.pop()
        ordered[name] = None

    for entry in entries:
        visit(entry)
    return list(ordered)


def _imported(name: str, text: str, pattern: re.Pattern[str]) -> list[str]:
    return [_target(name, match[match.re.groups]) for match in pattern.finditer(text)]


def _target(name: str, relative: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(name), relative))


def _block(
    name: str, text: str, numbers: Mapping[str, str], first: frozenset[str]
) -> str:
    """A module as a function that is called at once, and returns what it exports."""

    def imported(match: re.Match[str]) -> str:
        default, listed, target = match.groups()
        bound = f"default: {default}" if default else ", ".join(_pairs(listed))
        return f"const {{ {bound} }} = {numbers[_target(name, target)]};"

    def imported_later(match: re.Match[str]) -> str:
        target = _target(name, match[1])
        if target in first or name not in first:
            return numbers[target]
        return f'(await import("./{LATER}")).{numbers[target]}'

    text = _LATER_IMPORT.sub(imported_later, _IMPORT.sub(imported, text))
    text, exported = _without_exports(name, text)
    begin = "await (async () => {" if name == ENTRY else "(() => {"
    end = f"return {{ {', '.join(exported)} }};\n}})();"
    return f"const {numbers[name]} = {begin} // {name}\n{text.strip()}\n{end}"


def _without_exports(name: str, text: str) -> tuple[str, list[str]]:
    """The text of a module with declarations alone, and the names that it exports."""
    exported: list[str] = []

    def listed(match: re.Match[str]) -> str:
        pairs = (pair.split(": ") for pair in _pairs(match[1]))
        exported.extend(f"{pair[-1]}: {pair[0]}" for pair in pairs)
        return ""

    def declared(match: re.Match[str]) -> str:
        exported.append(match[1])
        return ""

    text = _EXPORT_LIST.sub(listed, text)
    if _EXPORT_DEFAULT in text:
        text = text.replace(_EXPORT_DEFAULT, "const $default = ")
        exported.append("default: $default")
    if name.startswith(_OWN):  # modules of others export nothing in another way
        text = _EXPORT.sub(declared, text)
        if _UNKNOWN_FORM.search(text):
            raise ValueError(f"{name} imports or exports in an unknown form")
    return text, exported


def _pairs(listed: str) -> list[str]:
    """Names of a list as an object's pattern has them: ``a as b`` is ``a: b``."""
    parts = (part.strip() for part in listed.split(","))
    return [re.sub(r"\s+as\s+", ": ", part) for part in parts if part]
