"""Evidence, histograms and geometry are unchanged after packing into bytes."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from app.measuring.evidence import (
    CHANNEL_NUMBERS,
    NUMBERS,
    Geometry,
    RecordLayout,
    pack_channels,
    pack_geometry,
    pack_numbers,
    pack_tag_counts,
    to_evidence,
    unpack_channels,
    unpack_chosen_tag_counts,
    unpack_geometry,
    unpack_numbers,
    unpack_tag_counts,
)
from filter_core.evidence_numbers import N_TAGS, ChannelNumbers, Evidence, NumberColumn

SCALARS = [name for name in NUMBERS.columns if name not in ("class_id", "xyxy")]
CLASSES = ("car", "truck", "walker")
RECTANGLES = st.one_of(
    st.none(), st.tuples(*[st.floats(-1e9, 1e9, allow_nan=False)] * 4)
)


@st.composite
def evidences(draw) -> Evidence:
    count = draw(st.integers(0, 6))

    def column(name):
        dtype = NUMBERS.dtype[name]
        return draw(arrays.arrays(dtype.base, (count, *dtype.shape)))

    index = draw(arrays.arrays(np.int32, count, elements=st.integers(0, 2)))
    xyxy = draw(arrays.arrays(np.float64, (count, 4)))
    columns = {name: column(name) for name in SCALARS}
    return Evidence(class_names=CLASSES, class_index=index, xyxy=xyxy, **columns)


@st.composite
def channel_numbers(draw) -> ChannelNumbers:
    numbers = ChannelNumbers.absent(draw(st.integers(0, 4)))
    for spec in fields(ChannelNumbers):
        column = getattr(numbers, spec.name)
        stored = CHANNEL_NUMBERS.dtype[spec.name].base
        column[:] = draw(arrays.arrays(stored, column.shape))
    return numbers


@given(evidences(), st.permutations([3, 17, 400]))
def test_evidence_numbers_round_trip(evidence, class_ids):
    record = unpack_numbers([pack_numbers(evidence, class_ids)], [len(evidence)])

    back = to_evidence(record, dict(zip(CLASSES, class_ids, strict=True)))

    for name in (*SCALARS, "class_index", "xyxy"):
        np.testing.assert_array_equal(getattr(back, name), getattr(evidence, name))


@given(st.lists(evidences(), max_size=4))
def test_records_of_several_frames_are_read_as_one_array(frames):
    packed = [pack_numbers(frame, [1, 2, 3]) for frame in frames]

    together = unpack_numbers(packed, list(map(len, frames)))

    assert together.tobytes() == b"".join(packed)
    assert len(together) == sum(map(len, frames))


@given(st.lists(st.one_of(st.none(), channel_numbers()), min_size=1, max_size=4))
def test_channel_numbers_round_trip_and_are_missing_for_other_frames(frames):
    counts = [2 if frame is None else len(frame) for frame in frames]
    packed = [pack_channels(frame) for frame in frames]

    back = unpack_channels(packed, counts)

    if back is None:
        assert not any(packed)
        return
    parts = [ChannelNumbers.absent(2) if frame is None else frame for frame in frames]
    for spec in fields(ChannelNumbers):
        column = getattr(back, spec.name)
        expected = np.concatenate([getattr(part, spec.name) for part in parts])
        np.testing.assert_array_equal(column, expected)
        assert column.dtype == expected.dtype


@given(st.lists(channel_numbers(), min_size=1, max_size=4), st.integers(0, 3))
def test_old_records_are_read_after_a_column_was_added(frames, newer_from):
    today = CHANNEL_NUMBERS
    newest = max(column.since for column in today.columns.values())
    added = NumberColumn("points near it", "points", "i8", -1, since=newest + 1)
    later = RecordLayout({"points_near": added, **today.columns})
    counts = [len(frame) for frame in frames]
    packed = [pack_channels(frame) or b"" for frame in frames]
    for place in range(newer_from, len(frames)):
        record = np.full(counts[place], 5, later.dtype)
        for name in today.columns:
            record[name] = getattr(frames[place], name)
        packed[place] = record.tobytes()

    read = later.read(packed, counts)

    assert later.dtype.names == (*(today.dtype.names or ()), "points_near")
    expected = np.repeat(
        [-1 if place < newer_from else 5 for place in range(len(frames))], counts
    )
    np.testing.assert_array_equal(read["points_near"], expected)
    for name in today.columns:
        column = np.concatenate([getattr(frame, name) for frame in frames])
        np.testing.assert_array_equal(read[name], column)


@pytest.mark.parametrize("length", [0, 1, 91, 93, 184])
def test_record_of_unknown_length_raises_value_error(length):
    columns = {"xyxy": NumberColumn("", "px", "f8", np.nan, width=4)}
    columns |= {f"count_{n}": NumberColumn("", "px", "i8", -1) for n in range(7)}
    layout = RecordLayout(columns | {"last": NumberColumn("", "px", "i4", -1)})

    with pytest.raises(ValueError, match=f"92 bytes for 1 boxes, found {length} bytes"):
        layout.read([bytes(length)], [1])


PIXELS = st.sampled_from([0, 0, 0, 1, 70_000, 64_000_000])
SHAPES = st.tuples(st.integers(0, 5), st.just(N_TAGS))


@given(arrays.arrays(np.int32, SHAPES, elements=PIXELS))
def test_tag_histograms_round_trip(counts):
    back = unpack_tag_counts(pack_tag_counts(counts), len(counts))

    np.testing.assert_array_equal(back, counts)


@given(st.lists(st.integers(0, 4), max_size=4), st.randoms(use_true_random=False))
def test_histograms_of_chosen_boxes_are_returned_in_the_given_order(sizes, random):
    frames = []
    for size in sizes:
        counts = [random.choice((0, 0, 7)) for _ in range(size * N_TAGS)]
        frames.append(np.array(counts, np.int32).reshape(size, N_TAGS))
    drawn = random.sample(range(sum(sizes)), random.randint(0, sum(sizes)))
    chosen = np.array(drawn, np.int64)

    back = unpack_chosen_tag_counts(list(map(pack_tag_counts, frames)), sizes, chosen)

    together = np.concatenate([np.empty((0, N_TAGS), np.int32), *frames])
    np.testing.assert_array_equal(back, together[chosen])


LINES = arrays.arrays(np.float32, st.tuples(st.integers(0, 12), st.just(4)))
GEOMETRIES = st.builds(Geometry, RECTANGLES, RECTANGLES, LINES)


@given(st.lists(st.one_of(st.none(), GEOMETRIES), max_size=5), st.booleans())
def test_geometry_round_trips(boxes, backwards):
    packed, places = pack_geometry(boxes), range(len(boxes))[:: -1 if backwards else 2]
    back = unpack_geometry(packed, len(boxes))
    chosen = unpack_geometry(packed, len(boxes), places)

    assert_geometry_equal(boxes, back)
    assert_geometry_equal([boxes[place] for place in places], chosen)


def assert_geometry_equal(boxes, back):
    for before, after in zip(boxes, back, strict=True):
        assert (before is None) == (after is None)
        if before is None or after is None:
            continue
        assert after.amodal_xyxy == before.amodal_xyxy
        assert after.visible_xyxy == before.visible_xyxy
        np.testing.assert_array_equal(after.edges, before.edges)
