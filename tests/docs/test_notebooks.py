"""The notebooks run against a live demo server, and are stored without outputs."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.command_line import CommandLine
from tests.support.demo_street import SEED, demo_street
from tests.support.servers import token_of
from tests.support.sources import CHECKOUT

NOTEBOOKS = sorted((CHECKOUT / "docs" / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """Run `unghost demo`; give its address and token as variables of a client.

    It finds its street rendered, as if it had run in this folder before.
    """
    unghost = CommandLine(tmp_path_factory.mktemp("demo"), {})
    data = unghost.folder / "demo-data"
    rendered = data / "demo" / f"street-{SEED}-1"
    shutil.copytree(
        demo_street().folder, rendered, ignore=shutil.ignore_patterns("*.part")
    )
    with unghost.running("demo", "--frames", 1, "--port", 0, "--json") as process:
        assert process.stdout is not None
        link = json.loads(process.stdout.readline())["login_link"]
        assert json.loads(process.stdout.readline())["dataset"] == "demo"
        token = token_of(data)
        assert list(rendered.parent.iterdir()) == [rendered]
        yield {"UNGHOST_SERVER": link.partition("/#")[0], "UNGHOST_TOKEN": token}


def run(path: Path, folder: Path, settings: dict[str, str]) -> str:
    """Run a notebook in a folder; give what it prints, and the types of outputs."""
    process = subprocess.run(
        [sys.executable, "-m", "tests.support.run_notebook", path],
        cwd=folder,
        env=CommandLine(folder, settings).environ | {"PYTHONPATH": str(CHECKOUT)},
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr
    return "\n".join(printed_outputs(json.loads(process.stdout)))


def printed_outputs(notebook):
    for cell in notebook["cells"]:
        for output in cell.get("outputs", ()):
            assert output.get("name") != "stderr", output
            yield "".join(output.get("text", ()))
            yield from output.get("data", ())


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_are_stored_without_outputs(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]

    assert code
    assert [cell["outputs"] for cell in code] == [[]] * len(code)
    assert {cell["execution_count"] for cell in code} == {None}


def test_client_notebook_runs(demo, tmp_path):
    said = run(CHECKOUT / "docs" / "notebooks" / "client.ipynb", tmp_path, demo)

    assert "1 frames, " in said
    assert said.count("image/webp") == 3
    assert "5 answers, 5 undone" in said
    assert "files, such as " in said
    assert [path.stem for path in NOTEBOOKS] == ["client"]
