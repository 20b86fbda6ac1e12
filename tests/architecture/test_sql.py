"""Only queries build SQL; elsewhere are sessions and errors, no statements."""

from __future__ import annotations

import ast

from tests.support.sources import Source, python_sources

# Opening, passing on and closing; nothing with which a statement could be written.
HARMLESS = {"URL", "Connection", "Engine", "Session", "event", "exc", "make_url"}
HARMLESS_MODULES = ("sqlalchemy.exc",)
SPEAKS_SQL = ("app/db/", "migrations/")
# With `queries.py` of each room. The first keeps its own rows of answers, the second
# takes away rows of all tables.
SPEAKS_SQL_TOO = (
    *("app/http/idempotency.py", "app/maintenance/removals.py", "app/verdicts.py"),
    *(f"app/boxes/{name}.py" for name in ("current", "filter", "orders")),
)
STATEMENT = {"execute", "exec_driver_sql", "scalars", "scalar"}


def may_speak(name: str) -> bool:
    """Whether a module is one of those that hold statements."""
    return name.startswith((*SPEAKS_SQL, *SPEAKS_SQL_TOO)) or name.endswith(
        "/queries.py"
    )


def builders(source: Source) -> list[str]:
    """What a module imports from SQLAlchemy that can build a statement."""
    return [
        f"{source.name}: {alias.name}"
        for node in ast.walk(source.tree)
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith("sqlalchemy")
        and node.module not in HARMLESS_MODULES
        for alias in node.names
        if alias.name not in HARMLESS
    ]


def calls(source: Source) -> list[str]:
    """Where a module runs a statement on a session or connection."""
    return [
        f"{source.name}:{node.lineno}"
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in STATEMENT
    ]


def test_only_queries_build_and_run_statements():
    outside = [
        source
        for source in python_sources("app", "unghost", "filter_core")
        if not may_speak(source.name)
    ]

    assert [found for source in outside for found in builders(source)] == []
    assert [found for source in outside for found in calls(source)] == []


def test_the_rule_would_notice_a_statement():
    source = Source(
        "app/runs/service.py", "from sqlalchemy import select\ns.execute(1)"
    )

    assert builders(source) == ["app/runs/service.py: select"]
    assert calls(source) == ["app/runs/service.py:2"]
