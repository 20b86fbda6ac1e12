"""The examples of the README are run as they are printed."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.documents import blocks, read
from tests.support.servers import running_server

CLIENT, LIBRARY = blocks(read("README.md"), "python")
CAR_OF_THE_EXAMPLE = np.s_[410:640, 83:466]
CAR_COLOR_BGR = (142, 0, 0)


def run(example):
    """Run a code block as a program of its own."""
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})


@pytest.fixture
def folder_with_a_frame(tmp_path, monkeypatch):
    """A folder to run in, with the image and the segmentation of the examples."""
    monkeypatch.chdir(tmp_path)
    colors = np.full((720, 1280, 3), 70, np.uint8)
    colors[CAR_OF_THE_EXAMPLE] = CAR_COLOR_BGR
    for name in ("000001.png", "000001.seg.png"):
        assert cv2.imwrite(name, colors)


def test_the_library_example_keeps_the_visible_car_and_rejects_the_ghost(capsys):
    run(LIBRARY)

    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("0 kept: 100 %")
    assert second.startswith("1 rejected: ")
    assert "Building" in second
    code = [line for line in LIBRARY.splitlines() if line.strip()]
    assert len([line for line in code if "import" not in line]) <= 10


@pytest.mark.usefixtures("folder_with_a_frame")
def test_client_example_uploads_a_frame_and_prints_its_explanation(
    start_server, monkeypatch, capsys
):
    server = start_server()
    monkeypatch.setenv("UNGHOST_SERVER", server.url)
    monkeypatch.setenv("UNGHOST_TOKEN", server.token)

    run(CLIENT)

    assert capsys.readouterr().out.startswith("7 kept: 100 %")


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
@pytest.mark.usefixtures("folder_with_a_frame")
def test_the_curl_example_uploads_a_frame(tmp_path):
    (example,) = (text for text in blocks(read("README.md"), "sh") if "curl" in text)

    with running_server(tmp_path / "unghost-data") as server:
        script = example.replace("http://127.0.0.1:8000", server.url)
        programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        process = subprocess.run(
            ["sh", "-euc", script],
            check=True,
            capture_output=True,
            text=True,
            env={**os.environ, "PATH": programs, "UNGHOST_SERVER": server.url},
        )

    dataset, frame = json_documents(process.stdout)
    assert dataset["name"] == "town11"
    assert [decision["verdict"] for decision in frame["decisions"]] == ["kept"]


def json_documents(text):
    """The JSON values that follow one another in a text."""
    while text.strip():
        value, end = json.JSONDecoder().raw_decode(text.lstrip())
        yield value
        text = text.lstrip()[end:]
