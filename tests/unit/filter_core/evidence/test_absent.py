"""`absent` tables: every column holds the value that means "not measured"."""

from __future__ import annotations

import numpy as np

from filter_core.types import ChannelNumbers, Evidence, number_columns


def test_absent_fills_every_column_with_its_missing_value():
    evidence = Evidence.absent(("car",), np.zeros(2, np.int32))
    channels = ChannelNumbers.absent(2)

    for table in (evidence, channels):
        for name, column in number_columns(type(table)).items():
            found = getattr(table, name)
            assert found.shape == (2, *column.shape)
            assert found.dtype == column.dtype
            np.testing.assert_equal(found, np.full_like(found, column.missing))
    assert len(evidence) == 2
    assert evidence.tag_counts is None
    assert evidence.channels is None
