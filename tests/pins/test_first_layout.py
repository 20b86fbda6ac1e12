"""Records as the first version stored them can still be read.

The bytes are written in this file, where rewriting the pins cannot change them. They
are those of the pin ``records`` at the first layout, without columns added later.
"""

import numpy as np

from app.measuring.evidence import CHANNEL_NUMBERS, NUMBERS

BOXES = 3
FIRST_NUMBERS = (
    "0700 00000001 00000000 00010000 64000000 00000000 0a000000 00000000 00180000 "
    "00000000 00000000 0000f03f 00000000 00000040 00000000 00000840 00000000 00001040 "
    "00000000 0000d03f 00000000 0000f43f 00000000 00000240 00000000 00000a40 29000000 "
    "01000100 00000001 00006500 00000000 00000b00 00000000 00000118 00000000 00000000 "
    "00000020 41400000 000000a0 41400000 00000020 42400000 000000a0 42400000 00000000 "
    "11400000 00000000 15400000 00000000 19400000 00000000 1d400700 00000201 02000000 "
    "00010000 66000000 00000000 0c000000 00000000 02180000 00000000 00000000 0000f87f "
    "00000000 0000f87f 00000000 0000f87f 00000000 0000f87f 00000000 00802040 00000000 "
    "00802240 00000000 00802440 00000000 00802640"
)
FIRST_CHANNELS = (
    "04000000 00000000 ffffffff ffffffff ffffffff 00000000 00a05040 00000000 0000f87f "
    "00000000 0000c03f ffffffff ffffffff 09000000 00000000 00000000 0000f87f 00000000 "
    "0000f87f 00000000 0000f87f 00000000 0000f87f 00000000 00000000 02000000 0c000000 "
    "00000000 00000000 0000f87f 00000000 0000f87f 00000000 0000f87f ffffffff ffffffff "
    "ffffffff ffffffff 00000000 0000f03f 00000000 00000040 00000000 00000840 00000000 "
    "00001040 ffffffff ffffffff 00000000 ffffffff ffffffff 00000000 0000f87f 00000000 "
    "0000f4bf 00000000 0000f87f 70110100 00000000 ffffffff ffffffff 00000000 0000f87f "
    "00000000 0000f87f 00000000 0000f87f 00000000 0000f87f"
)


def test_numbers_of_the_first_layout_are_read():
    record = NUMBERS.read([bytes.fromhex(FIRST_NUMBERS)], [BOXES])

    assert record["class_id"].tolist() == [7, 41, 7]
    assert record["state"].tolist() == [0, 1, 2]
    assert record["measured"].tolist() == [True, False, True]
    assert (record["accept_mask"] - 2**40).tolist() == [0, 1, 2]
    assert record["box_pixels"].tolist() == [100, 101, 102]
    assert record["matched_pixels"].tolist() == [10, 11, 12]
    assert record["image_pixels"].tolist() == [6144, 6145, 6146]
    for name, first in {
        "match_percent": 1.0,
        "area_percent": 2.0,
        "crowding": 3.0,
        "distance": 4.0,
    }.items():
        np.testing.assert_equal(record[name], [first, first + 33.25, np.nan])
    assert record["xyxy"].ravel().tolist() == [number + 0.25 for number in range(12)]


def test_channels_of_the_first_layout_are_read():
    record = CHANNEL_NUMBERS.read([bytes.fromhex(FIRST_CHANNELS)], [BOXES])

    assert record["owned_pixels"].tolist() == [4, 0, -1]
    assert record["explained_by"].tolist() == [-1, 2, 0]
    assert record["depth_pixels"].tolist() == [-1, 12, -1]
    assert record["instance_pixels"].tolist() == [-1, -1, 70_000]
    assert record["lidar_points"].tolist() == [9, -1, -1]
    np.testing.assert_equal(record["nearer_percent"], [66.5, np.nan, np.nan])
    np.testing.assert_equal(record["depth_gap"], [np.nan, np.nan, -1.25])
    np.testing.assert_equal(record["center_gap"], [0.125, np.nan, np.nan])
    assert record["tight_xyxy"][1].tolist() == [1, 2, 3, 4]
