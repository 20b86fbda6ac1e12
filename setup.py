"""What pyproject.toml cannot say: the page and the migrations join the wheel.

`static/` and `migrations/` lie at the top of the repository, where people look for
them. In a wheel they live inside the package, as `app/_static` and `app/_migrations`,
so that they cannot collide with other projects; `app.package` finds them in either.

Two builds of a commit give the same bytes: SOURCE_DATE_EPOCH sets the times of the
files, and their modes are the same whatever the umask of who builds.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

RESOURCES = {"static": "_static", "migrations": "_migrations"}
NOT_SHIPPED = shutil.ignore_patterns(
    "__pycache__", "*.py[co]", ".*", "*.d.ts", "node_modules"
)


class BuildWithResources(build_py):
    """Copies the resource folders next to the modules of `app`."""

    def run(self) -> None:
        super().run()
        if self.editable_mode:
            return
        for source, inside in RESOURCES.items():
            target = Path(self.build_lib, "app", inside)
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(source, target, ignore=NOT_SHIPPED)
        for path in Path(self.build_lib).rglob("*"):
            path.chmod(0o755 if path.is_dir() else 0o644)


os.umask(0o022)
setup(cmdclass={"build_py": BuildWithResources})
