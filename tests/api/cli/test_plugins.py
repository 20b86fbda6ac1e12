"""Formats of installed packages: the example of the documentation, and broken ones."""

import json
import shutil
import subprocess
import sys

import httpx
import pytest

from tests.support.archives import TAR, lines_of, tar_archive
from tests.support.command_line import CommandLine
from tests.support.folders import LAYOUT_FILES, write_files
from tests.support.frames import write_manifest
from tests.support.servers import running_server
from tests.support.sources import CHECKOUT
from unghost import Client

EXAMPLE = CHECKOUT / "docs" / "plugin"
RECORDING = EXAMPLE / "example"
DONE, REFUSED, USAGE, PARTLY = 0, 1, 2, 3


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the example's package, as pip installs it."""
    folder = tmp_path_factory.mktemp("site")
    source = folder / "source"
    shutil.copytree(EXAMPLE, source, ignore=shutil.ignore_patterns("__pycache__"))
    offline = ("--no-deps", "--no-build-isolation", "--no-index", "--quiet")
    install = [sys.executable, "-m", "pip", "install", *offline, str(source)]
    target = folder / "packages"
    subprocess.run([*install, "--target", str(target)], check=True)
    return target


@pytest.fixture
def command(site, tmp_path):
    """The command line with the example's package."""
    return CommandLine(tmp_path, {"PYTHONPATH": f"{site}:{CHECKOUT}"})


def test_plugin_is_recognised_named_and_described(command, tmp_path):
    described = shutil.copytree(RECORDING, tmp_path / "described")
    (described / "recording.yaml").write_text("layout: corners\n")

    results = [
        command("filter", RECORDING),
        command("filter", RECORDING, "--layout", "corners"),
        command("filter", described),
    ]

    for result in results:
        assert result.code == DONE, result.err
        assert [record["key"] for record in result.records] == ["1", "2"]
        verdicts = [each["verdict"] for each in result.records[0]["decisions"]]
        assert verdicts == ["kept", "rejected"]
    converted = command("convert", RECORDING, "--to", "coco", "--output", "coco")
    assert converted.code == DONE, converted.err
    (written,) = (tmp_path / "coco" / "annotations").glob("*train.json")
    assert json.loads(written.read_text())["categories"][0]["name"] == "car"
    inspected = command("inspect", RECORDING)
    assert inspected.code == DONE, inspected.err
    assert "Corner files, recognised by corners/ with files that beg" in inspected.out
    misspelt = command("filter", RECORDING, "--layout", "corner")
    assert misspelt.code == USAGE
    assert "'corner' is not one of 'auto', " in misspelt.err
    assert "'corners'" in misspelt.err


def test_plugin_is_read_by_push_and_the_service(command, site, tmp_path):
    settings = {"PYTHONPATH": f"{site}:{CHECKOUT}"}
    with running_server(tmp_path / "data", settings) as server:
        to_server = ("--server", server.url, "--token", server.token)
        pushed = command("push", RECORDING, "--dataset", "street", *to_server)
        assert pushed.code == DONE, pushed.err
        with Client(server.url, server.token) as client:
            kept = client.stats("street").by_class["car"].kept
        assert kept == 2
        # As the page sends them: without the content of images.
        files = [
            (
                path.relative_to(RECORDING).as_posix(),
                path.read_bytes() if path.suffix == ".txt" else b"",
            )
            for path in sorted(RECORDING.rglob("*.*"))
        ]
        for layout in ("auto", "corners"):
            response = post_folder(server, files, layout)
            assert response.status_code == 200, response.text
            head, *frames, end = lines_of(response.text)
            assert (head["layout"], head["layouts"]) == ("corners", ["corners"])
            assert head["titles"] == {"corners": "Corner files"}
            assert [len(frame["annotation"]["boxes"]) for frame in frames] == [2, 2]
            assert (end["frames"], end["faulty"], end["unmatched"]) == (2, 0, 0)
        response = post_folder(server, files, "corner")
        assert response.status_code == 422
        (fault,) = response.json()["errors"]
        assert fault["pointer"] == "/query/layout"
        assert fault["detail"].endswith("table, pairs, corners")


def post_folder(server, files, layout):
    return httpx.post(
        f"{server.url}/api/v1/folders",
        params={"layout": layout},
        content=tar_archive(files),
        headers={**server.headers, **TAR},
    )


def package(folder, name, entries, **modules):
    """An installed package with entry points and modules, in a folder."""
    info = folder / f"{name}-1.0.dist-info"
    groups = "".join(f"{entry}\n" for entry in entries)
    return write_files(
        folder,
        {
            f"{info.name}/METADATA": f"Name: {name}\nVersion: 1.0\n",
            f"{info.name}/entry_points.txt": f"[unghost.formats]\n{groups}",
            **{f"{module}.py": text for module, text in modules.items()},
        },
    )


def test_broken_plugin_is_named_with_its_package_and_hinders_nothing(site, tmp_path):
    packages = tmp_path / "packages"
    package(packages, "broken", ["torn = torn"], torn="import no_such_module\n")
    package(packages, "bare", ["bare = bare"], bare="")
    package(packages, "thief", ["yolo = unghost_corners"])
    package(packages, "late", ["corners = unghost_corners"])
    package(packages, "other", ["angles = unghost_corners"])
    command = CommandLine(tmp_path, {"PYTHONPATH": f"{packages}:{site}:{CHECKOUT}"})

    result = command("filter", write_manifest(tmp_path / "frames", 1))
    own = command("filter", RECORDING)
    named = command("filter", RECORDING, "--layout", "torn")

    assert (result.code, own.code) == (DONE, DONE), result.err + own.err
    for sentence in (
        "the plug-in 'torn' of the package broken 1.0 is not used: "
        "ModuleNotFoundError: No module named 'no_such_module'",
        "the plug-in 'bare' of the package bare 1.0 is not used: bare: expected one "
        "Format, found 0",
        "the plug-in 'yolo' of the package thief 1.0 is not used: Unghost has a format "
        "of this name",
        "the plug-in 'corners' of the package unghost-corners 1.0 is not used: late "
        "1.0 has a format of this name",
        "the plug-in 'angles' of the package other 1.0 is not used: its format is "
        "called 'corners'; expected the name of the entry point",
    ):
        assert sentence in result.err
        assert sentence in own.err
    assert named.code == REFUSED
    assert "'torn' of the package broken 1.0 is not used: ModuleNot" in named.err


FAILING = """
from filter_core.formats.format import Format
FAILING = Format(name="failing", title="", docs_row="")
@FAILING.recogniser
def recognise(source):
    raise KeyError("x")
@FAILING.reader
def read(root, options):
    raise KeyError("y")
"""


def test_error_of_a_plugin_names_its_package_and_the_remedy(tmp_path):
    packages = package(
        tmp_path / "packages", "failing", ["failing = failing"], failing=FAILING
    )
    command = CommandLine(tmp_path, {"PYTHONPATH": f"{packages}:{CHECKOUT}"})
    folder = write_files(tmp_path / "frames", LAYOUT_FILES["pairs"])

    recognised = command("inspect", folder)
    read = command("filter", folder, "--layout", "failing")
    remedy = command("inspect", folder, "--layout", "pairs")

    why = "the plug-in 'failing' of the package failing 1.0 fails with KeyError: "
    assert recognised.code == REFUSED
    remedy_of = "`layout` in recording.yaml (--layout) names another layout"
    assert f"{why}'x'; {remedy_of}" in recognised.err
    assert read.code == REFUSED
    assert f"{why}'y'" in read.err
    assert "failing" not in remedy.err
