"""Small recordings from public bug reports, whose images were taken for others.

Each is a street with a visible object N in front of a hidden one, G, and a free one, F;
in those of JPEGs, A and the bus are visible, and B is hidden.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import ImageError, SegmentationError
from filter_core.evidence.depth import read_depth
from filter_core.formats.registry import read_source
from filter_core.local import FrameOutcome, filter_source
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from tests.support.pictures import pixels_of, png
from tests.support.shared_data import shared

DEPTH, INSTANCES = "cases/02-depth-encodings", "cases/03-instance-images"
JPEGS = "cases/01-jpeg-raw-tags"


def outcome_of(case: str, config: FilterConfig) -> FrameOutcome:
    (outcome,) = filter_source(read_source(shared(case)), config, workers=1)
    return outcome


def verdicts_of(outcome: FrameOutcome) -> dict[str, tuple[str, str | None]]:
    assert outcome.decisions is not None, outcome.error
    return {one["id"]: (one["verdict"], one["evidence"]) for one in outcome.decisions}


def truth(evidence: str) -> dict[str, tuple[str, str]]:
    verdicts = {"N": "kept", "G": "rejected", "F": "kept"}
    return {name: (verdict, evidence) for name, verdict in verdicts.items()}


@pytest.mark.parametrize("evidence", ["auto", "instance"])
@pytest.mark.parametrize("folder", ["bgr-7679", "bgr-7680"])
def test_swapped_instances_are_read_whatever_their_ids(folder, evidence):
    outcome = outcome_of(f"{INSTANCES}/{folder}", FilterConfig(evidence=evidence))

    assert verdicts_of(outcome) == truth("instance")
    assert outcome.notes == (
        "red and blue are swapped in the instance image; read as bgr",
    )


@pytest.mark.parametrize("lossy", ["refuse", "nearest"])
@pytest.mark.parametrize("folder", ["grey95", "rawred95", "rawred95-as-png"])
def test_raw_tags_that_were_a_jpeg_are_refused(folder, lossy):
    outcome = outcome_of(f"{JPEGS}/{folder}", FilterConfig(lossy_segmentation=lossy))

    assert outcome.error is not None
    assert "raw tags in a JPEG are lost" in outcome.error["detail"]
    assert "nearest" not in outcome.error["detail"]


@pytest.mark.parametrize("part", ["055212", "055244", "055304"])
def test_recorded_photo_and_depth_are_no_segmentation(part):
    folder = shared("cases/recordings/carla_tutorial")
    options = SegmentationOptions(lossy="nearest")

    real = read_segmentation((folder / f"{part}_semseg.png").read_bytes(), options)
    assert not real.lossy
    for name in (f"{part}.png", f"{part}_depth.png"):
        with pytest.raises(SegmentationError):
            read_segmentation((folder / name).read_bytes(), options)
    with pytest.raises(ImageError, match="256 steps"):
        read_depth((folder / f"{part}_depth.png").read_bytes())


@pytest.mark.parametrize("camera", ["FRONT", "LEFT"])
def test_recorded_depth_is_recognised_in_either_order(camera):
    (path,) = shared("cases/recordings/selma").glob(f"*/DEPTHCAM_{camera}/*.png")
    content = path.read_bytes()

    right = read_depth(content)
    swapped = read_depth(png(pixels_of(content), "rgb"))

    assert (right.encoding, right.is_certain) == ("carla", True)
    assert (swapped.encoding, swapped.is_certain) == ("carla-bgr", True)


def test_depth_in_another_unit_is_no_evidence(tmp_path):
    """All pixels are ten times as far away as CARLA would have stored them."""
    (source,) = read_source(shared(f"{DEPTH}/raw"))
    steps = read_depth(source.others["depth"].read_bytes()).steps(np.s_[:, :])
    steps = np.minimum(steps.astype(np.int64) * 10, (1 << 24) - 1)
    colors = np.dstack([steps & 255, steps >> 8 & 255, steps >> 16]).astype(np.uint8)
    (tmp_path / "depth.png").write_bytes(png(colors))
    scaled = replace(source, others={"depth": tmp_path / "depth.png"})

    (outcome,) = filter_source([scaled], FilterConfig(evidence="auto"), workers=1)

    assert verdicts_of(outcome) == truth("ordered")
    assert "behind each of the" in outcome.notes[0]
