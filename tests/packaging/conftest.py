"""The wheel of this checkout, built once, and installed in an empty environment.

The dependencies come from the environment that runs the tests; the project itself
comes from the wheel and from nowhere else.
"""

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.installation import (
    Installation,
    build_distributions,
    install,
    install_lowest,
)
from tests.support.sources import CHECKOUT

# Tests that run meanwhile write and remove files in some of these.
NOT_SOURCE = shutil.ignore_patterns(
    *(".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "node_modules"),
    *("build", "dist", "*.egg-info", "*-data", ".data"),
)


@pytest.fixture(scope="session")
def distributions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist, and the wheel that was built from that sdist."""
    source = tmp_path_factory.mktemp("source") / "unghost"
    shutil.copytree(CHECKOUT, source, ignore=NOT_SOURCE)
    build_distributions(source)
    return source / "dist"


@pytest.fixture(scope="session")
def wheel(distributions: Path) -> Path:
    """The path of the wheel."""
    (wheel,) = distributions.glob("unghost-*.whl")
    return wheel


@pytest.fixture(scope="session")
def installation(wheel: Path) -> Iterator[Installation]:
    """The wheel, installed in an environment of its own outside of the checkout."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # Every user of the machine can read an installation.
        folder.chmod(0o755)
        yield install(wheel, folder)


@pytest.fixture
def lowest_installation(wheel: Path, tmp_path: Path) -> Installation:
    """The wheel, installed with the lowest versions of other packages."""
    return install_lowest(wheel, tmp_path)
