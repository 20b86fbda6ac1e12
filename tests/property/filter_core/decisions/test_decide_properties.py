"""`decide` equals a slow, simple definition, for any order and number of boxes."""

import math
from dataclasses import fields, replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from filter_core.config.filter import FilterConfig
from filter_core.decisions.rules import decide
from filter_core.evidence_numbers import BoxState
from filter_core.verdicts import Reason
from tests.support.evidence import ACCEPTS_CAR, evidence_of

NAMES = ("car", "van", "traffic_light")
PERCENTAGES = [0, 0.1, 2, 10, 33.3, 50, 70, 99.9, 100]
PERCENT = st.sampled_from(PERCENTAGES)
METRES = st.sampled_from([None, None, 50.5, 100])
Z95 = 1.959963984540054


@st.composite
def boxes(draw):
    """Two hundred boxes, most of which a threshold decides, and some exactly at it."""
    random = draw(st.randoms(use_true_random=True))
    return [random_box(random) for _ in range(200)]


def random_box(random):
    pixels = random.choice([40, 100, 1000, 1000, 5000])
    percent = random.choice([*PERCENTAGES, random.uniform(0, 100)])
    matched = round(percent * pixels / 100)
    unknown = random.choice([0, 0, 0, random.randint(0, pixels - matched)])
    return {
        "class_index": random.randrange(len(NAMES)),
        "state": random.choice([0] * 20 + [*BoxState]),
        "accept_mask": random.choice([ACCEPTS_CAR] * 9 + [0]),
        "measured": random.random() < 0.9,
        "box_pixels": pixels,
        "matched_pixels": matched,
        "unknown_pixels": unknown,
        "match_percent": 100 * matched / pixels,
        "area_percent": random.choice(PERCENTAGES),
        "distance": random.choice([math.nan, 0, 5, 50.5, 100, 101]),
    }


@st.composite
def thresholds(draw, keys):
    kinds = {"min_visible_pixels": st.integers(0, 50), "max_distance": METRES}
    return {key: draw(kinds.get(key, PERCENT)) for key in draw(st.sets(keys))}


SHARES = ["threshold_small_box", "size_big_box", "threshold_big_box"]
NUMBERS = st.sampled_from([*SHARES, "min_visible_pixels", "max_distance"])


@st.composite
def configs(draw):
    raw = draw(thresholds(NUMBERS))
    raw["profile"] = draw(st.sampled_from(["paper", "carlasimu"]))
    raw["classes"] = {name: draw(thresholds(NUMBERS)) for name in NAMES[1:]}
    if draw(st.booleans()):
        raw["classes"]["van"]["measures_as"] = "pass"
    return FilterConfig.from_mapping(raw)


def slow(box, config):
    """The reason and threshold of one box, as described in filter.md."""
    reason, threshold = slow_by_pixels(box, config)
    if config.profile == "carlasimu" or reason not in BY_PIXELS:
        return reason, threshold
    matched = box["matched_pixels"] + box["unknown_pixels"]
    as_matched = {
        **box,
        "matched_pixels": matched,
        "match_percent": 100 * matched / box["box_pixels"],
    }
    if slow_by_pixels(as_matched, config)[0] == Reason.VISIBLE:
        return Reason.UNKNOWN_PIXELS, None
    return reason, threshold


BY_PIXELS = (
    Reason.NO_VISIBLE_PIXELS,
    Reason.LARGE_BELOW_THRESHOLD,
    Reason.BELOW_THRESHOLD,
)


def slow_by_pixels(box, config):
    """The reason and threshold of one box, by Algorithm 2."""
    name = NAMES[box["class_index"]]

    def limit(key):
        return getattr(config.limits_of(name), key)

    published = config.profile == "carlasimu"
    match, area = box["match_percent"], box["area_percent"]
    small, big = limit("threshold_small_box"), limit("threshold_big_box")
    size = limit("size_big_box")
    large = area >= size if published else area > size

    def fails(threshold):
        return match <= threshold if published else match < threshold

    early = early_reason(
        box, config, limit("max_distance"), limit("min_visible_pixels")
    )
    if early is not None:
        return early, None
    if large and fails(big):
        return Reason.LARGE_BELOW_THRESHOLD, big
    if (published or not large) and fails(small):
        return Reason.BELOW_THRESHOLD, small
    if not large:
        return Reason.VISIBLE, small
    return Reason.VISIBLE, max(small, big) if published else big


def early_reason(box, config, max_distance, min_visible_pixels):
    states = {
        BoxState.OUTSIDE_IMAGE: Reason.OUTSIDE_IMAGE,
        BoxState.COVERS_IMAGE: Reason.COVERS_IMAGE,
        BoxState.DEGENERATE: Reason.DEGENERATE,
        BoxState.NOT_AHEAD: Reason.OUT_OF_RANGE,
    }
    if box["state"] in states:
        return states[box["state"]]
    if max_distance is not None and box["distance"] > max_distance:
        return Reason.OUT_OF_RANGE
    if config.of_class(NAMES[box["class_index"]]).measures_as == "pass":
        return Reason.PASSED
    if box["accept_mask"] == 0:
        published = config.profile == "carlasimu"
        return Reason.DROPPED_CLASS if published else Reason.UNMAPPED_CLASS
    if not box["measured"]:
        return Reason.NO_SEGMENTATION
    if box["matched_pixels"] < min_visible_pixels:
        return Reason.NO_VISIBLE_PIXELS
    return None


def wilson_interval(share, pixels):
    """The Wilson score interval at 95 % (Wilson 1927), by the usual formula."""
    z2 = Z95 * Z95
    centre = (share + z2 / (2 * pixels)) / (1 + z2 / pixels)
    half = math.sqrt(share * (1 - share) / pixels + z2 / (4 * pixels**2))
    half *= Z95 / (1 + z2 / pixels)
    return centre - half, centre + half


@given(boxes(), configs())
def test_decide_equals_the_slow_definition(given_boxes, config):
    """A toss-up is a threshold within the Wilson interval of the match."""
    decisions = decide(evidence_of(given_boxes, NAMES), config)

    for index, box in enumerate(given_boxes):
        reason, threshold = slow(box, config)
        assert decisions.reason[index] == reason
        if threshold is None:
            compared = decisions.threshold[index], decisions.margin[index]
            assert np.isnan(compared).all()
            assert not decisions.toss_up[index]
            assert not decisions.large[index]
            continue
        assert decisions.threshold[index] == threshold
        assert decisions.margin[index] == box["match_percent"] - threshold
        share = box["matched_pixels"] / box["box_pixels"]
        low, high = wilson_interval(share, box["box_pixels"])
        published, area = config.profile == "carlasimu", box["area_percent"]
        size = config.limits_of(NAMES[box["class_index"]]).size_big_box
        assert decisions.large[index] == (area > size or (published and area == size))
        limit = threshold / 100
        if min(abs(limit - low), abs(limit - high)) > 1e-9:
            assert decisions.toss_up[index] == (low <= limit <= high)


@given(configs())
def test_many_boxes_in_blocks_are_decided_the_same_as_few(config):
    """So many boxes are decided in several blocks, which must not change a result."""
    few = evidence_of(
        [{"class_index": i % 3, "match_percent": 7.0 * i} for i in range(15)], NAMES
    )
    rows = np.arange(70_000) % len(few)
    many = replace(
        few,
        **{
            spec.name: getattr(few, spec.name)[rows]
            for spec in fields(few)
            if isinstance(getattr(few, spec.name), np.ndarray)
        },
    )

    alone, all_of_them = decide(few, config), decide(many, config)

    np.testing.assert_array_equal(all_of_them.reason, alone.reason[rows])
    np.testing.assert_array_equal(all_of_them.margin, alone.margin[rows])
