"""The pipeline of docs/pipeline.md runs literally: pushed, gated, reviewed, trained."""

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.documents import blocks, read
from tests.support.frames import write_manifest
from tests.support.waiting import until
from unghost import Client

(PROGRAM, *_) = blocks(read("docs/pipeline.md"), "python")

TRAINER = """
import sys, pathlib, yaml
data = pathlib.Path(sys.argv[1])
parts = yaml.safe_load(data.read_text())
labels = sorted(data.parent.rglob("labels/**/*.txt"))
boxes = [line.split() for label in labels for line in label.read_text().splitlines()]
print("trainer:", len(labels), "labels,", len(boxes), "boxes,", parts["names"][0])
"""


@pytest.fixture
def started(server, tmp_path):
    """Starts the pipeline on a recording of four frames, with a trainer."""
    write_manifest(tmp_path / "recording", 4)
    (tmp_path / "pipeline.py").write_text(PROGRAM)
    (tmp_path / "train.py").write_text(TRAINER)
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    train = (sys.executable, "train.py")

    def start(dataset: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "pipeline.py", "recording", dataset, *train],
            cwd=tmp_path,
            env={**os.environ, "PATH": programs, **settings},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    return start


def test_pipeline_waits_for_people_then_exports_and_trains(server, started, tmp_path):
    with started("pipeline") as process, Client(server.url, server.token) as client:
        until(lambda: (tmp_path / "pipeline/pipeline/gates.md").exists())
        for _ in range(client.stats("pipeline").to_review):
            (box,) = client.queue("pipeline", limit=1).items
            client.review(box.box_id, "reject", seen_revision=box.revision)
        out, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        (version,) = client.versions("pipeline")

    lines = out.splitlines()
    work = tmp_path / "pipeline" / "pipeline"
    (archive,) = work.glob("labels-*.zip")
    name = archive.stem.removeprefix("labels-")
    assert hashlib.sha256(archive.read_bytes()).hexdigest() == version.sha256
    assert json.loads((work / "trained_on.json").read_text()) == {name: version.version}
    assert "trainer: 4 labels, 4 boxes, car" in lines
    digest = (version.version or "")[:12]
    assert lines[-1] == f"trained on 4 frames, version {name} ({digest})"
    assert 30 <= len([line for line in PROGRAM.splitlines() if line.strip()]) <= 40


def test_pipeline_stops_at_a_gate(server, started, tmp_path):
    manifest = tmp_path / "recording" / "manifest.jsonl"
    text = manifest.read_text()
    manifest.write_text(text.replace("[20, 24, 40, 40]", "[2, 4, 14, 14]"))

    with started("gated") as process:
        _, err = process.communicate(timeout=120)

    assert process.returncode == 1
    assert "'rejected > 60%'" in err
    report = (tmp_path / "pipeline/gated/gates.md").read_text()
    assert "| `rejected > 60%` | 100.00% (8 of 8 boxes) | failed |" in report
    assert "returned non-zero exit status 4" in err
    assert not (tmp_path / "pipeline/gated/labels").exists()
