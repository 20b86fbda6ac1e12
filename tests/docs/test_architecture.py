"""ARCHITECTURE.md agrees with the code where a program can compare them."""

import ast
import re
from functools import cache
from pathlib import PurePosixPath

import pytest

from app.db import tables
from app.db.tables import access
from app.ingest.batch import LONGEST_WAIT_S, MOST_TOGETHER
from app.jobs.attempts import MOST_ATTEMPTS
from app.jobs.events import INTERVAL_S
from app.jobs.leases import LEASE_LASTS, RENEW_EVERY_S, WATCHDOG_EVERY_S
from app.runs.measure import COMMIT_EVERY_S
from app.settings import Settings
from tests.support.documents import names_in_rows
from tests.support.sources import CHECKOUT, page_sources, python_sources

TEXT = (CHECKOUT / "ARCHITECTURE.md").read_text("utf-8")
WORDS = " ".join(TEXT.split())
NAMED = sorted(set(re.findall(r"`([^`\n]+)`", TEXT)))
SUFFIXES = (".py", ".js", ".md", ".json", ".toml")
# Words in code style that other programs define: SQLite, PostgreSQL, Python, browsers.
OF_OTHER_PROGRAMS = {
    *("BEGIN IMMEDIATE", "COPY", "executemany", "synchronous=FULL", "count(*)"),
    *("Any", "requestAnimationFrame"),
}
# Definitions in JavaScript: constants, functions, classes, and methods of objects. The
# tests have no parser of JavaScript; here only the names that it defines are needed.
JAVASCRIPT = re.compile(
    r"\b(?:const|function|class)\s+(\w+)|^ +(?:async )?(\w+)(?:\(.*\) \{$|: \()", re.M
)
# Files in which texts are names: of tables, columns and views, of values on the wire or
# of keys.
STRINGS_ARE_NAMES = (
    *("app/db/tables/", "migrations/", "unghost/wire/words.py"),
    "filter_core/config/keys.py",
)
COMMANDS = ("python -m", "make", "npm run", "POST ", "UNGHOST_")


@cache
def files() -> frozenset[str]:
    """All files and folders that the document may name, relative to the checkout."""
    tops = (
        "app filter_core unghost static migrations tests benchmarks tools deploy docs"
    )
    paths = {
        path.relative_to(CHECKOUT).as_posix()
        for top in tops.split()
        for path in (CHECKOUT / top).rglob("*")
        if not {"__pycache__", "node_modules"} & {*path.parts}
    }
    return frozenset(paths) | {path.name for path in CHECKOUT.iterdir()}


def matching_files(named: str) -> list[str]:
    """Files and folders whose path ends with `named`, which may lack its first parts.

    The document writes `boxes/reader.py` where `app/boxes/reader.py` is clear.
    """
    path = named.rstrip("/")
    return [file for file in files() if f"/{file}".endswith(f"/{path}")]


@cache
def defined_in(file: str) -> frozenset[str]:
    """The names that a file defines: functions, classes, variables, parameters."""
    text = (CHECKOUT / file).read_text("utf-8")
    if not file.endswith(".py"):
        return frozenset(one or other for one, other in JAVASCRIPT.findall(text))
    nodes = list(ast.walk(ast.parse(text)))
    strings = file.startswith(STRINGS_ARE_NAMES)
    names = {name for node in nodes for name in names_of(node, strings=strings)}
    return frozenset(names)


def names_of(node: ast.AST, *, strings: bool) -> list[str]:
    """The names that one node of a Python syntax tree defines.

    With `strings`, those of its texts as well.
    """
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return [node.name]
    if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
        return [node.id]
    if isinstance(node, ast.arg):
        return [node.arg]
    if strings and isinstance(node, ast.Constant) and isinstance(node.value, str):
        return [node.value, *re.findall(r"CREATE VIEW (\w+)", node.value)]
    return []


def is_path(named: str) -> bool:
    return "/" in named or named.endswith(SUFFIXES)


def is_command(named: str) -> bool:
    return named in OF_OTHER_PROGRAMS or named.startswith(COMMANDS)


FILES = [n for n in NAMED if is_path(n) and not is_command(n)]
# Of a setting with a value, only the setting has to be defined.
DEFINITIONS = {
    named: frozenset(re.findall(r"\w+", named.partition("=")[0]))
    for named in NAMED
    if not is_path(named) and not is_command(named)
}


@cache
def definitions() -> frozenset[str]:
    """The words of `DEFINITIONS` that the code defines or that name a file."""
    missing = frozenset().union(*DEFINITIONS.values())
    defined = missing & {PurePosixPath(file).stem for file in files()}
    for source in (*page_sources(), *python_sources()):
        missing -= defined
        # A module without any of the words that are left is not parsed.
        if source.name.endswith((".py", ".js")) and is_any_in(source.text, missing):
            defined |= missing & defined_in(source.name)
    return defined


def is_any_in(text: str, words: frozenset[str]) -> bool:
    """Whether a text has one of the words. If there is none, it is not split."""
    return bool(words) and not words.isdisjoint(re.findall(r"\w+", text))


@pytest.mark.parametrize("named", FILES)
def test_named_files_exist(named):
    assert matching_files(named)


@pytest.mark.parametrize("named", DEFINITIONS)
def test_named_definitions_exist(named):
    assert DEFINITIONS[named] - definitions() == frozenset()


PLACED = re.findall(r"`(\w+)` (?:in|of)\s+`([\w./]+\.(?:py|js))`", TEXT) + re.findall(
    r"\d\. `([\w./]+\.(?:py|js))`: `(\w+)`", TEXT
)


@pytest.mark.parametrize(("one", "other"), PLACED)
def test_named_definitions_are_in_the_named_files(one, other):
    name, file = (other, one) if is_path(one) else (one, other)

    assert any(name in defined_in(path) for path in matching_files(file))


def walks() -> list[tuple[str, str]]:
    """(heading, text) of each numbered step in the section "Data in motion"."""
    part = TEXT.partition("\n## Data in motion\n")[2].partition("\n## ")[0]
    steps = []
    for section in part.split("\n### ")[1:]:
        heading = section.partition("\n")[0]
        # A step ends at the first paragraph that is not indented.
        steps += [
            (heading, re.split(r"\n\n(?! )", step)[0])
            for step in re.split(r"\n\d+\. ", section)[1:]
        ]
    return steps


def named_modules(text: str) -> list[str]:
    """The modules that exist among those that a text names."""
    named = re.findall(r"`([^`\n]+\.(?:py|js))`", text)
    return [name for name in named if matching_files(name)]


def test_every_step_of_a_walk_names_a_module_that_exists():
    required = {"A request", "An upload", "An answer", "A threshold", "A run"}

    assert {heading for heading, _ in walks()} >= required
    assert [step for _, step in walks() if not named_modules(step)] == []


def test_commands_that_import_the_service_match_the_import_contract():
    project = (CHECKOUT / "pyproject.toml").read_text("utf-8")
    allowed = set(re.findall(r'"unghost\.cli\.(\w+) -> app', project))
    said = WORDS.partition("In `unghost`, only commands")[2].partition(". ")[0]

    assert set(re.findall(r"`cli/(\w+)\.py`", said)) == allowed


@pytest.mark.parametrize(
    ("sentence", "figure", "expected"),
    [
        ("that expires after eight seconds", LEASE_LASTS.total_seconds(), 8),
        ("which happens every two seconds", RENEW_EVERY_S, 2),
        ("when its watchdog looks next, every two seconds", WATCHDOG_EVERY_S, 2),
        ("If it crashes three processes and stores no result", MOST_ATTEMPTS, 3),
        ("Evidence is stored four times a second", COMMIT_EVERY_S, 0.25),
        ("a POST and its response, for 72 hours (`UNGHOST_IDEMPOTENCY_HOURS`)",
         Settings.model_fields["idempotency_hours"].default, 72),
        ("means reading its row, five times a second", INTERVAL_S, 0.2),
        ("up to 32 of them, or those of 100 ms", (MOST_TOGETHER, LONGEST_WAIT_S),
         (32, 0.1)),
    ],
)  # fmt: skip
def test_figures_in_sentences_match_the_code(sentence, figure, expected):
    assert sentence in WORDS
    assert figure == expected


def test_table_of_stored_data_has_every_table_of_the_database_once():
    rows = names_in_rows(TEXT, "## What is stored")

    declared = {**tables.Frame.metadata.tables, **access.Token.metadata.tables}
    assert sorted(name for row in rows for name in row) == sorted(declared)
