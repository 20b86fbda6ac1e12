"""What is packed into bytes comes back bit for bit."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from app.db.evidence_record import (
    NUMBERS,
    Geometry,
    pack_geometry,
    pack_numbers,
    pack_tag_counts,
    to_evidence,
    unpack_geometry,
    unpack_numbers,
    unpack_tag_counts,
)
from filter_core.types import N_TAGS, Evidence

SCALARS = [name for name in NUMBERS.names or () if name not in ("class_id", "xyxy")]
LIMITS = {"state": (0, 3), "accept_mask": (0, 2**30), "measured": (False, True)}
CLASSES = ("car", "truck", "walker")
RECTANGLES = st.one_of(
    st.none(),
    st.tuples(*[st.floats(-1e9, 1e9, allow_nan=False)] * 4),
)


@st.composite
def evidences(draw) -> Evidence:
    count = draw(st.integers(0, 6))

    def column(name):
        dtype = NUMBERS[name]
        return draw(arrays.arrays(dtype, count))

    index = draw(arrays.arrays(np.int32, count, elements=st.integers(0, 2)))
    xyxy = draw(arrays.arrays(np.float64, (count, 4)))
    columns = {name: column(name) for name in SCALARS}
    return Evidence(class_names=CLASSES, class_index=index, xyxy=xyxy, **columns)


@given(evidences(), st.permutations([3, 17, 400]))
def test_numbers_come_back(evidence, class_ids):
    record = unpack_numbers([pack_numbers(evidence, class_ids)])

    back = to_evidence(record, CLASSES, class_ids)

    for name in (*SCALARS, "class_index", "xyxy"):
        np.testing.assert_array_equal(getattr(back, name), getattr(evidence, name))


@given(st.lists(evidences(), max_size=4))
def test_frames_one_after_the_other_are_one_array(frames):
    packed = [pack_numbers(frame, [1, 2, 3]) for frame in frames]

    together = unpack_numbers(packed)

    assert together.tobytes() == b"".join(packed)
    assert len(together) == sum(map(len, frames))


@given(
    arrays.arrays(
        np.int32,
        st.tuples(st.integers(0, 5), st.just(N_TAGS)),
        elements=st.sampled_from([0, 0, 0, 1, 70_000, 64_000_000]),
    )
)
def test_histograms_come_back(counts):
    back = unpack_tag_counts(pack_tag_counts(counts), len(counts))

    np.testing.assert_array_equal(back, counts)


@given(
    st.lists(
        st.one_of(
            st.none(),
            st.builds(
                Geometry,
                RECTANGLES,
                RECTANGLES,
                arrays.arrays(np.float32, st.tuples(st.integers(0, 12), st.just(4))),
            ),
        ),
        max_size=5,
    )
)
def test_geometry_comes_back(boxes):
    back = unpack_geometry(pack_geometry(boxes), len(boxes))

    for before, after in zip(boxes, back, strict=True):
        assert (before is None) == (after is None)
        if before is None or after is None:
            continue
        assert after.amodal_xyxy == before.amodal_xyxy
        assert after.visible_xyxy == before.visible_xyxy
        np.testing.assert_array_equal(after.edges, before.edges)
