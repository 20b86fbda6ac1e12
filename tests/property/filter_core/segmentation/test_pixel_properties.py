"""The fast ways to count an image's pixels equal looking at every pixel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst

from filter_core.evidence.counting import Regions, count_codes_in, count_pixels
from filter_core.images.pixels import (
    count_codes,
    occurring_codes,
    run_ends,
    run_lengths,
)
from filter_core.segmentation.codes import exact_codes
from filter_core.segmentation.palettes import UNCHANGED
from filter_core.segmentation.reading import segmentation_from_tags
from tests.support.pictures import FAMILY, painted

WIDTHS = st.sampled_from([1, 5, 7, 8, 16, 24, 31])
TAGS = st.sampled_from([0, 1, 3, 9, 14, 15, 29, 255])


@st.composite
def pictures(draw):
    """Images in which all rows are equal, except for a few single pixels."""
    width, height = draw(WIDTHS), draw(st.integers(1, 12))
    row = draw(npst.arrays(np.uint8, width, elements=TAGS))
    picture = np.repeat(row[None, :], height, axis=0)
    places = st.tuples(st.integers(0, height - 1), st.integers(0, width - 1), TAGS)
    for y, x, tag in draw(st.lists(places, max_size=6)):
        picture[y, x] = tag
    return picture


@given(pictures())
def test_occurring_codes_and_their_counts_are_those_of_the_pixels(picture):
    rgb = painted(picture)

    occurring = occurring_codes(rgb, exact_codes(UNCHANGED))
    counts = count_codes(rgb, exact_codes(UNCHANGED))

    packed = rgb.astype(np.int64) @ [1 << 16, 1 << 8, 1]
    every = np.bincount(exact_codes(UNCHANGED)[packed].ravel(), minlength=256)
    np.testing.assert_array_equal(counts, every)
    assert occurring == np.flatnonzero(every).tolist()


@given(npst.arrays(np.uint8, st.integers(0, 40), elements=st.integers(0, 2)), st.data())
def test_run_ends_and_lengths_rebuild_the_values(values, data):
    stops = sorted(data.draw(st.sets(st.integers(0, len(values)))))

    ends = run_ends(values, np.array(stops, np.int64))

    rebuilt = np.repeat(values[ends], run_lengths(ends))
    np.testing.assert_array_equal(rebuilt, values)
    assert {stop - 1 for stop in stops if stop} <= set(ends.tolist())


@pytest.mark.parametrize("count", [1, 5_000], ids=["by pixels", "by tables"])
@pytest.mark.parametrize("kept", [False, True], ids=["all pixels", "some ignored"])
def test_region_counts_equal_looking_at_every_pixel(count, kept):
    rng = np.random.default_rng(5)
    tags = rng.choice(np.array([1, 14, 15], np.uint8), (60, 80))
    keep = rng.random(tags.shape) < 0.7 if kept else None
    corner, size = rng.integers(0, 40, (count, 2)), rng.integers(0, 20, (count, 2))
    bounds = np.hstack([corner, corner + size])
    regions = Regions(segmentation_from_tags(tags, FAMILY).codes, bounds, keep)

    counts = count_codes_in(regions, [14, 15])

    every = np.ones(tags.shape, np.bool_) if keep is None else keep
    for index in rng.integers(0, count, 50):
        x0, y0, x1, y1 = bounds[index]
        inside = tags[y0:y1, x0:x1][every[y0:y1, x0:x1]]
        assert counts[index].tolist() == [(inside == 14).sum(), (inside == 15).sum()]
        assert count_pixels(regions)[index] == inside.size
