"""A function that is given a database session neither ends it nor opens another one.

The exceptions are listed here.
"""

import ast

from tests.support.sources import python_sources

ENDING = {"commit", "rollback"}
OPENING = {"read", "write", "write_out_of_turn"}
ALLOWED = {
    "app/http/transaction.py:commit_and_respond",
    *("app/jobs/service.py:interrupt", "app/datasets/service.py:remove_dataset"),
}
"""Functions that may do so; each explains it in its docstring."""
OPEN_A_SECOND_ONE = {"app.jobs.chunks", "app.jobs.queries"}
"""Modules that may open a second transaction while another one writes.

A final step of a job that takes long reads from time to time whether the job has been
cancelled, and on PostgreSQL stores its progress: see `Task` in `app.jobs.kind`.
"""


def is_given_a_session(function):
    arguments = (*function.args.args, *function.args.kwonlyargs)
    return any(
        isinstance(arg.annotation, ast.Name) and arg.annotation.id == "Session"
        for arg in arguments
    )


def ends_or_opens_a_session(function):
    """Whether a function ends a session, or is given one and opens another one."""
    has_session = is_given_a_session(function)
    calls = [
        (ast.unparse(node.func.value), node.func.attr)
        for node in ast.walk(function)
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in ENDING | OPENING
    ]
    return any(
        (name in ENDING and owner.endswith("session"))
        or (has_session and name in OPENING and owner.endswith("database"))
        for owner, name in calls
    )


def test_functions_with_a_session_neither_end_nor_open_transactions():
    nested = {
        f"{source.name}:{function.name}"
        for source in python_sources("app")
        for function in ast.walk(source.tree)
        if isinstance(function, (ast.FunctionDef, ast.AsyncFunctionDef))
        and ends_or_opens_a_session(function)
    }

    assert nested == ALLOWED


def test_no_transaction_begins_within_a_writing_transaction(recorded_access):
    """Others wait to write meanwhile, and the inner one reads another state."""
    assert recorded_access.writes
    assert recorded_access.nested_transactions <= OPEN_A_SECOND_ONE
