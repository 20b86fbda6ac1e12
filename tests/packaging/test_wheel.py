"""The wheel has all files that the package needs, which are found, and no others."""

import tarfile
import zipfile
from pathlib import Path

import pytest

from tests.support.installation import Installation, build_distributions
from tests.support.sources import CHECKOUT


def names_in(wheel: Path) -> list[str]:
    """The names of all files in the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return archive.namelist()


def expected_files(folder: str, pattern: str) -> set[str]:
    """The names of a checkout folder's files that belong in the wheel."""
    return {
        path.relative_to(CHECKOUT / folder).as_posix()
        for path in (CHECKOUT / folder).rglob(pattern)
        if path.is_file() and "__pycache__" not in path.parts
    }


@pytest.mark.parametrize(
    ("folder", "inside"), [("static", "app/_static"), ("migrations", "app/_migrations")]
)
def test_wheel_contains_every_resource_inside_the_package(wheel, folder, inside):
    names = names_in(wheel)

    carried = {
        name.removeprefix(f"{inside}/") for name in names if name.startswith(inside)
    }

    # Types are for the type checker alone.
    assert carried == expected_files(folder, "*") - expected_files(folder, "*.d.ts")


def test_the_wheel_has_every_module_and_the_type_markers(wheel):
    names = set(names_in(wheel))

    for package in ("app", "filter_core", "unghost"):
        modules = expected_files(package, "*.py") | expected_files(package, "*.pyi")
        assert {f"{package}/{name}" for name in modules} <= names
    files = {"filter_core/py.typed", "unghost/py.typed", "unghost/cli/page.css"}
    assert files <= names


def test_wheel_has_no_other_top_level_packages(wheel):
    tops = {name.split("/")[0] for name in names_in(wheel)}

    assert {top for top in tops if not top.endswith(".dist-info")} == {
        "app",
        "filter_core",
        "unghost",
    }


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


def test_installed_command_prints_its_help(installation: Installation):
    outcome = installation.run(str(installation.command("unghost")), "--help")

    assert outcome.returncode == 0, outcome.stderr
    assert "push" in outcome.stdout


def test_resources_are_found_in_the_installed_package(installation: Installation):
    outcome = installation.run(
        "-c",
        "from app import package\n"
        "print(package.static_dir())\nprint(package.migrations_dir())",
    )

    static, migrations = (Path(line) for line in outcome.stdout.splitlines())
    assert (static.name, migrations.name) == ("_static", "_migrations")
    assert installation.python.parents[1] in static.parents
