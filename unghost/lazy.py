"""Packages whose names are imported from other modules when they are first used.

Such a package lists its names once, as imports in the stub `__init__.pyi` beside its
`__init__.py`. Type checkers and editors read the stub instead of the package;
`imports_of_stub` reads it when the program runs.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module


def imports_of_stub(
    package: str,
) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Make the functions `__getattr__` and `__dir__` of a package, by its `__name__`.

    Its stub has lines such as ``from unghost.wire.runs import Run as Run``. Python
    calls the first function for a name that the package does not have: it imports the
    name from the module that the stub says, and keeps it in the package. It also gives
    the package's `__all__`: all names of the stub. Raises AttributeError for others.
    """
    present = vars(sys.modules[package])

    def get(name: str) -> object:
        module_of = _module_of_each_name(package)
        if name == "__all__":
            return sorted(module_of)
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value: object = getattr(import_module(module_of[name]), name)
        present[name] = value
        return value

    def names() -> list[str]:
        return sorted({*present, *_module_of_each_name(package)})

    return get, names


@cache
def _module_of_each_name(package: str) -> dict[str, str]:
    # Loaded here, because `import unghost` alone does not need them.
    import ast
    import pkgutil

    stub = pkgutil.get_data(package, "__init__.pyi")
    assert stub is not None, "a package in a folder or in a ZIP archive has its files"
    return {
        each.name: str(statement.module)
        for statement in ast.parse(stub).body
        if isinstance(statement, ast.ImportFrom)
        for each in statement.names
    }
