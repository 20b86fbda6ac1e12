"""`make experiment ARGS=--small` renders, trains with torchvision, and reports."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.sources import CHECKOUT

TORCH = Path(os.environ.get("TRAIN_PYTHON", CHECKOUT / ".venv/train/bin/python"))

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(
        not TORCH.exists(),
        reason="no environment with torch: make experiment makes one",
    ),
]


def test_small_experiment_runs(tmp_path):
    command = [sys.executable, "-m", "benchmarks.experiment", tmp_path, "--small"]

    subprocess.run([*command, "--python", TORCH], cwd=CHECKOUT, check=True)

    (report,) = tmp_path.glob("*/report.json")
    experiment = json.loads(report.read_text())
    assert list(experiment["arms"]) == ["raw", "perfect"]
    assert {arm["trials"] for arm in experiment["arms"].values()} == {1}
    assert experiment["noise"]["frames"] == 12
