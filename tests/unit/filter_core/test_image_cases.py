"""A small recording from a public bug report, whose images were taken for others.

It is a street with a visible object N before a hidden one, G, and a free one, F.
"""

from dataclasses import replace

import numpy as np

from filter_core.config.filter import FilterConfig
from filter_core.evidence.depth import read_depth
from filter_core.formats.registry import read_source
from filter_core.local import filter_source
from tests.support.pictures import png
from tests.support.shared_data import shared


def test_depth_in_another_unit_is_no_evidence(tmp_path):
    """All pixels are ten times as far away as CARLA would have stored them."""
    (source,) = read_source(shared("cases/02-depth-encodings/raw"))
    steps = read_depth(source.others["depth"].read_bytes()).steps(np.s_[:, :])
    steps = np.minimum(steps.astype(np.int64) * 10, (1 << 24) - 1)
    colors = np.dstack([steps & 255, steps >> 8 & 255, steps >> 16]).astype(np.uint8)
    (tmp_path / "depth.png").write_bytes(png(colors))
    scaled = replace(source, others={"depth": tmp_path / "depth.png"})

    (outcome,) = filter_source([scaled], FilterConfig(evidence="auto"), workers=1)

    assert outcome.decisions is not None, outcome.error
    assert {box["evidence"] for box in outcome.decisions} == {"ordered"}
    verdicts = {box["id"]: box["verdict"] for box in outcome.decisions}
    assert verdicts == {"N": "kept", "G": "rejected", "F": "kept"}
    assert "behind each of the" in outcome.notes[0]
