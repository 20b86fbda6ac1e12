"""Boxes whose pixels have tags that nobody knows are unmeasured, and this is said."""

from dataclasses import replace

import numpy as np
import pytest

from app.context import ServiceContext
from app.measuring.columns import ColumnCache
from app.runs.flips import current_histogram
from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.pipeline import FrameOptions, filter_frame, read_and_measure
from filter_core.verdicts import Reason
from tests.support import frames as scene
from tests.support.pictures import png

CHANGED_CAR = 100
"""The tag of cars in a changed CARLA."""

FAR = [50, 30, 55, 34]
BOXES = [
    {"id": "far", "class": "car", "xyxy": FAR},
    {"id": "near", "class": "car", "xyxy": scene.ON_THE_CAR},
    {"id": "sky", "class": "car", "xyxy": scene.IN_THE_SKY},
    {"id": "edge", "class": "car", "xyxy": [2, 2, 55, 34]},
]
FRAME = {"carla_version": "0.9.15", "boxes": BOXES}


def tags():
    """The scene with a far car of an unknown tag: less than 1 % of the image."""
    pixels = scene.tags()
    pixels[FAR[1] : FAR[3], FAR[0] : FAR[2]] = CHANGED_CAR
    assert (pixels == CHANGED_CAR).mean() < 0.01
    return pixels


def decisions(config):
    result = filter_frame(FRAME, png(tags()), FilterConfig.from_mapping(config))
    return {decision["id"]: decision for decision in result.decisions}


def test_box_that_its_unknown_pixels_could_keep_is_unmeasured():
    by_box = decisions({"threshold_small_box": 20})

    assert {name: box["reason"] for name, box in by_box.items()} == {
        "far": "unknown_pixels",
        "near": "visible",
        "sky": "no_visible_pixels",
        "edge": "below_threshold",
    }
    far = by_box["far"]
    assert (far["verdict"], far["unknown_pixels"], far["box_pixels"]) == (
        "unmeasured",
        20,
        20,
    )
    assert far["explanation"] == (
        "unmeasured: 100 % of its pixels have a tag or colour that is not known; "
        "as Car they would keep it"
    )
    assert (far["threshold"], far["margin"], far["toss_up"]) == (None, None, False)


@pytest.mark.parametrize("evidence", ["ordered", "auto"])
def test_channels_that_count_tags_do_not_reject_for_unknown_ones(evidence):
    boxes = [{**box, "distance": 10 + at} for at, box in enumerate(BOXES)]
    config = FilterConfig.from_mapping({"evidence": evidence})

    result = filter_frame({**FRAME, "boxes": boxes}, png(tags()), config)

    reasons = {box["id"]: box["reason"] for box in result.decisions}
    assert reasons["far"] == "unknown_pixels"
    assert reasons["sky"] == "no_visible_pixels"


def test_profile_carlasimu_stays_as_published():
    assert decisions({"profile": "carlasimu"})["far"]["verdict"] == "rejected"


def test_service_stores_unknown_pixels_and_says_their_share_by_class(services):
    street = services.dataset()
    street.put("a", FRAME, segmentation=png(tags()))
    street.put("b", FRAME, image=scene.image())  # its pixels are not known at all

    reasons = [reason for _, reason in sorted(street.reasons().items())]
    assert reasons[0] == Reason.UNKNOWN_PIXELS
    context: ServiceContext = services.context
    with context.database.read() as session:
        shares = current_histogram(context, session, street.row(session), 10)
    x0, y0, x1, y1 = np.array([box["xyxy"] for box in BOXES]).T
    pixels = ((x1 - x0) * (y1 - y0)).sum()
    assert shares.unknown_percent == {"car": pytest.approx(100 * 40 / pixels)}
    assert np.sum(shares.classes["car"]) == len(BOXES)


def test_histogram_is_without_boxes_that_have_too_few_visible_pixels(services):
    street = services.dataset()
    street.put("a", FRAME, segmentation=png(tags()))

    with services.context.database.read() as session:
        dataset = street.row(session)
        measurement = dataset.active_measurement_id
        cache = services.context.one(ColumnCache)
        numbers = cache.load(session, dataset.id, measurement)
    counts = [
        numbers.share_counts((), 10, FilterConfig(min_visible_pixels=needed)).sum()
        for needed in (1, 10**6)
    ]

    has_some = int((numbers.evidence.matched_pixels > 0).sum())
    assert counts == [len(BOXES), len(BOXES) - has_some]
    assert has_some > 0


def test_numbers_of_the_first_version_have_no_unknown_pixels():
    config = replace(FilterConfig().measuring(), version=1)

    measured = read_and_measure(FRAME, png(tags()), config, FrameOptions())

    reasons = decide(measured.evidence, FilterConfig()).reason
    assert not measured.evidence.unknown_pixels.any()
    assert reasons[0] == Reason.NO_VISIBLE_PIXELS
