"""Pins of what others build on: the OpenAPI document, routes, names, loaded modules."""

import re
import subprocess
import sys
from pathlib import Path
from tempfile import gettempdir
from typing import Any, Final

import filter_core
import unghost
from app.main import create_app
from app.settings import Settings
from tests.support.documents import DOCUMENTS, blocks
from tests.support.routes import every_route, operations

OWN: Final = ("app", "filter_core", "unghost")
# Packages that others load only with some versions of Python; they are left out.
_BACKPORTS: Final = {"exceptiongroup", "typing_extensions"}
IMPORTS: Final = {
    "filter_core": "import filter_core",
    "unghost": "import unghost",
    "a client": "from unghost import Client; Client('http://127.0.0.1:1', 'a')",
    "the command line": "import unghost.cli",
}
_IMPORT: Final = re.compile(
    r"^\s*(?:from|import) (?:filter_core|unghost)\b.*$", re.MULTILINE
)
_PROGRAM: Final = """
import sys
before = set(sys.modules)
{statement}
files = {{name: getattr(module, "__file__", None) or getattr(module, "__path__", None)
          for name, module in sys.modules.items() if name not in before}}
print(*(name for name, file in files.items() if file), sep="\\n")
"""


def openapi() -> dict[str, Any]:
    never_made = Path(gettempdir()) / "unghost-never-made"
    return create_app(Settings(data=never_made)).openapi()


def routes() -> list[str]:
    """Method and path of all routes, hidden ones too, in the order they are tried."""
    return [
        f"{method} {path}"
        for route in every_route()
        for method, path in sorted(operations(route))
    ]


def names() -> dict[str, list[str]]:
    """The public names of the packages, and the imports in the documents' examples."""
    promised: dict[str, list[str]] = {}
    for module in (filter_core, unghost):
        promised[module.__name__] = sorted(module.__all__)
        missing = [name for name in module.__all__ if not hasattr(module, name)]
        assert not missing, f"{module.__name__} promises what it lacks: {missing}"
    imports = {
        line.strip()
        for document in DOCUMENTS
        for block in blocks(document.read_text("utf-8"), "python")
        for line in _IMPORT.findall(block)
    }
    for statement in sorted(imports):
        exec(statement, {})
    return {**promised, "documents": sorted(imports)}


def modules() -> dict[str, dict[str, Any]]:
    """Which packages of others each import loads, and how many modules of ours."""
    return {name: _loaded(statement) for name, statement in IMPORTS.items()}


def _loaded(statement: str) -> dict[str, Any]:
    program = _PROGRAM.format(statement=statement)
    done = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    loaded = done.stdout.split()
    packages = {name.partition(".")[0] for name in loaded}
    others = packages - {*sys.stdlib_module_names, *OWN, *_BACKPORTS}
    return {
        "packages": sorted(others),
        "own modules": sum(name.partition(".")[0] in OWN for name in loaded),
    }
