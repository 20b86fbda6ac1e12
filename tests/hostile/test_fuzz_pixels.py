"""Fuzzing of images and point clouds: each gives a result or our own error."""

import zlib
from contextlib import suppress
from functools import partial

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from app.ingest.check import KINDS, check_files
from app.settings import Settings
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import FilterError
from filter_core.evidence.depth import read_depth
from filter_core.evidence.instances import read_instances
from filter_core.evidence.lidar import PointsError, read_points
from filter_core.images.header import read_image_header
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from tests.support import pictures
from tests.support.hostile.mutations import damaged, fuzz_settings, little_memory
from tests.support.hostile.pixel_samples import CLOUDS, IMAGES, WH, npy, npy_of, ply

pytestmark = pytest.mark.long

SIDE = 512
NEAREST = SegmentationOptions(lossy="nearest")
READERS = {
    "header": partial(read_image_header, max_side=SIDE),
    "segmentation": partial(read_segmentation, max_side=SIDE),
    "lossy segmentation": partial(read_segmentation, options=NEAREST, max_side=SIDE),
    "depth": partial(read_depth, max_side=SIDE),
    "instances": partial(read_instances, max_side=SIDE),
    "ignore mask": lambda content: read_ignore_mask(content, WH),
}


@st.composite
def forged_pngs(draw: st.DrawFn) -> bytes:
    """PNG files whose chunks have right checksums and arbitrary content."""
    sides = st.sampled_from([0, 1, 8, 64, 511, 512, 513, 2**16, 2**31 - 1, 2**32 - 1])
    numbers = [draw(sides), draw(sides)]
    numbers += [draw(st.sampled_from([0, 1, 2, 4, 8, 16, 255])) for _ in range(2)]
    kinds = st.sampled_from(
        [b"IDAT", b"PLTE", b"tRNS", b"acTL", b"eXIf", b"IEND", b"zzzz"]
    )
    bodies = st.one_of(
        st.binary(max_size=40), st.binary(max_size=200).map(zlib.compress)
    )
    chunks = draw(st.lists(st.builds(pictures.chunk, kinds, bodies), max_size=4))
    return pictures.png_of_chunks(tuple(numbers), *chunks)


@pytest.mark.parametrize("reader", READERS.values(), ids=READERS)
@fuzz_settings
@given(content=st.one_of(damaged(IMAGES), forged_pngs(), st.binary(max_size=64)))
def test_any_image_gives_a_result_or_raises_our_own_error(reader, content):
    with little_memory(), suppress(FilterError):
        reader(content)


dtypes = st.sampled_from(
    ["'<f8'", "'O'", "'S9'", "'V0'", "'<U4'", "[('x', '<f4')]", "[('x', '<f4', (3,))]",
     "[('x', [('y', '<f4')])]", "('<f4', 3)", "[('x', 'O')]", "[]", "7", "'<M8[s]'"]
)  # fmt: skip
shapes = st.sampled_from(
    ["(3, 6)", "(3,)", "()", "(0, 6)", "(-1, 6)", "(10**9, 6)", "(1000000000, 6)",
     "(4611686018427387904, 6)", "(True, 6)", "(2.5, 6)", "'x'", "(3, 6, 1)",
     "(1" + "0" * 30 + ",)"]
)  # fmt: skip
NPY_HEADER = "{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 6), }}\n"
forged_npys = st.builds(
    "{{'descr': {}, 'fortran_order': {}, 'shape': {}, }}{}".format,
    dtypes,
    st.sampled_from(["True", "False", "3", "None"]),
    shapes,
    st.sampled_from(["\n", "", " (", "L\n", "'''", "\n\n  x\n y", "\\", "\x00"]),
).map(npy_of)


@fuzz_settings
@given(content=st.one_of(damaged(CLOUDS), forged_npys, st.binary(max_size=64)))
@example(ply("ascii", b"", "9" * 5000))
@example(npy_of("{'descr': (("))
@example(npy_of(NPY_HEADER.format(10**9)))
@example(npy(np.full((2, 6), 1e300)))
@example(npy(np.full((2, 6), [0, 0, 0, 0, 0, np.nan])))
def test_any_point_cloud_gives_points_or_raises_our_own_error(content):
    with little_memory(), suppress(PointsError):
        read_points(content)


@fuzz_settings
@given(
    files=st.dictionaries(
        st.sampled_from(KINDS), st.one_of(damaged(IMAGES), damaged(CLOUDS)), max_size=3
    )
)
def test_any_set_of_files_is_accepted_or_raises_our_own_error(files):
    annotation = parse_annotation({"boxes": []})
    with suppress(FilterError):
        check_files(files, annotation, Settings())
