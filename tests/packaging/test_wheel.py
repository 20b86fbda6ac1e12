"""The wheel has all files that the package needs, which are found, and no others."""

import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.support.installation import Installation, build_distributions
from tests.support.sources import CHECKOUT


def expected_files(folder: str, pattern: str) -> set[str]:
    """The names of a checkout folder's files that belong in the wheel."""
    return {
        path.relative_to(CHECKOUT / folder).as_posix()
        for path in (CHECKOUT / folder).rglob(pattern)
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_wheel_has_every_resource_and_module_of_its_packages_and_no_others(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())

    for folder in ("static", "migrations"):
        inside = f"app/_{folder}"
        carried = {
            name.removeprefix(f"{inside}/") for name in names if name.startswith(inside)
        }
        # Types are for the type checker alone.
        types = expected_files(folder, "*.d.ts")
        assert carried == expected_files(folder, "*") - types
    packages = {"app", "filter_core", "unghost"}
    for package in packages:
        modules = expected_files(package, "*.py") | expected_files(package, "*.pyi")
        assert {f"{package}/{name}" for name in modules} <= names
    files = {"filter_core/py.typed", "unghost/py.typed", "unghost/cli/page.css"}
    assert files <= names
    tops = {name.split("/")[0] for name in names}
    assert {top for top in tops if not top.endswith(".dist-info")} == packages


def test_the_sdist_has_what_the_wheel_is_built_from(distributions: Path):
    (archive,) = distributions.glob("unghost-*.tar.gz")

    with tarfile.open(archive) as sdist:
        names = {name.partition("/")[2] for name in sdist.getnames()}

    assert {"LICENSE", "README.md", "pyproject.toml", "setup.py"} <= names
    assert {f"static/{name}" for name in expected_files("static", "*")} <= names
    assert {f"migrations/{name}" for name in expected_files("migrations", "*")} <= names


@pytest.mark.long
def test_another_build_gives_the_same_wheel(
    distributions: Path, wheel: Path, tmp_path: Path
):
    (archive,) = distributions.glob("unghost-*.tar.gz")
    with tarfile.open(archive) as sdist:
        sdist.extractall(tmp_path, filter="data")
    (source,) = tmp_path.iterdir()
    for path in source.rglob("*.py"):
        path.chmod(0o600)  # as a checkout has them for who keeps files private

    build_distributions(source, "--wheel", umask=0o077)

    (again,) = (source / "dist").iterdir()
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()


def test_installed_command_prints_its_help_and_finds_resources(
    installation: Installation,
):
    outcome = installation.run(str(installation.command("unghost")), "--help")

    assert outcome.returncode == 0, outcome.stderr
    assert "push" in outcome.stdout
    outcome = installation.run(
        "-c",
        "from app import package\n"
        "print(package.static_dir())\nprint(package.migrations_dir())",
    )

    static, migrations = (Path(line) for line in outcome.stdout.splitlines())
    assert (static.name, migrations.name) == ("_static", "_migrations")
    assert installation.python.parents[1] in static.parents
