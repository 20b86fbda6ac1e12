"""Only modules of queries build and run SQL statements.

Other modules may import SQLAlchemy's sessions and errors, nothing that could build a
statement. import-linter cannot check this: for it SQLAlchemy is one module.
"""

import ast
from fnmatch import fnmatchcase

from tests.support.sources import Source, imports, python_sources

# Names for connecting and for types and errors; none of them can build a statement.
HARMLESS_NAMES = {"URL", "Connection", "Engine", "Session", "event", "exc", "make_url"}
HARMLESS_MODULES = ("sqlalchemy.exc",)
HAVE_STATEMENTS = (
    *("app/catalog/*.py", "app/db/*.py", "app/*/queries.py", "app/verdicts.py"),
    *("app/boxes/current.py", "app/boxes/filter.py", "app/boxes/orders.py"),
    # Their statements are understood only together with the code around them.
    *("app/jobs/chunks.py", "app/jobs/leases.py"),
    # The first one has a table to itself; the second one removes rows of all tables.
    *("app/http/idempotency.py", "app/maintenance/removals.py"),
)
RUN_STATEMENTS = {"execute", "exec_driver_sql", "scalars", "scalar"}


def builders(source: Source) -> list[str]:
    """What a module imports from SQLAlchemy that can build a statement."""
    return [
        f"{source.name}: {alias.name}"
        for node in imports(source)
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").startswith("sqlalchemy")
        and node.module not in HARMLESS_MODULES
        for alias in node.names
        if alias.name not in HARMLESS_NAMES
    ]


def calls(source: Source) -> list[str]:
    """Where a module runs a statement on a session or connection."""
    if not any(f".{name}" in source.text for name in RUN_STATEMENTS):
        return []  # reading the text is quicker than parsing it
    return [
        f"{source.name}:{node.lineno}"
        for node in ast.walk(source.tree)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in RUN_STATEMENTS
    ]


def test_only_queries_build_and_run_statements():
    outside = [
        source
        for source in python_sources("app", "unghost", "filter_core")
        if not any(fnmatchcase(source.name, pattern) for pattern in HAVE_STATEMENTS)
    ]

    assert [place for source in outside for place in builders(source)] == []
    assert [place for source in outside for place in calls(source)] == []


def test_statement_outside_of_queries_is_detected():
    source = Source(
        "app/runs/service.py", "from sqlalchemy import select\ns.execute(1)"
    )

    assert builders(source) == ["app/runs/service.py: select"]
    assert calls(source) == ["app/runs/service.py:2"]
