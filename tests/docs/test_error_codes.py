"""Every code of a problem that the service can send is in the table of codes."""

import ast
import re
from collections.abc import Iterator

from app.http.problems import HTTP_CODES
from tests.support.sources import CHECKOUT
from unghost.wire.codes import ERROR_CODES

FAULTS = ("Fault", "Failure", "add")
"""What has codes of single errors, or of runs and exports."""
LOCAL = {"code", "no_geometry", "several_geometries"}
"""A name that is passed on, and codes of faults."""


def codes_in(source: ast.AST) -> Iterator[str]:
    """Values of `code` of classes and of calls, and of a `Refusal`."""
    for node in ast.walk(source):
        if isinstance(node, ast.ClassDef):
            for statement in node.body:
                if isinstance(statement, ast.Assign | ast.AnnAssign):
                    written = ast.unparse(statement)
                    text = re.fullmatch(r"code\b[^=]* = '(\w+)'", written)
                    yield from text.groups() if text else ()
        elif isinstance(node, ast.Call):
            name = called(node.func)
            codes = [word.value for word in node.keywords if word.arg == "code"]
            codes += node.args[1:2] if name == "Refusal" else []
            for code in codes if name not in FAULTS else []:
                yield from texts(code)


def called(function: ast.expr) -> str:
    """The name of what is called, without that of its module or object."""
    if isinstance(function, ast.Attribute):
        return function.attr
    return function.id if isinstance(function, ast.Name) else ""


def texts(value: ast.expr) -> Iterator[str]:
    if isinstance(value, ast.Constant) and isinstance(value.value, str):
        yield value.value


def sent_codes() -> set[str]:
    files = [
        path
        for name in ("app", "filter_core")
        for path in (CHECKOUT / name).rglob("*.py")
    ]
    codes = {
        code for path in files for code in codes_in(ast.parse(path.read_text("utf-8")))
    }
    # Made of the name of a job, and of what is wrong with the boxes.
    composed = {"run_over", "export_over", "wrong_unit", "wrong_corners"}
    return (
        {code for code in codes if code}
        | composed
        | set(HTTP_CODES.values())
        | {"http_error"}
    )


def test_every_code_is_in_the_table_and_every_code_of_the_table_is_sent():
    assert sent_codes() - LOCAL == set(ERROR_CODES)
