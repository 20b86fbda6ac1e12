"""`ChannelNumbers.absent`: every column holds the value that means "not measured"."""

from __future__ import annotations

import numpy as np

from filter_core.evidence_numbers import ChannelNumbers, number_columns


def test_absent_fills_every_column_with_its_missing_value():
    channels = ChannelNumbers.absent(2)

    for name, column in number_columns(ChannelNumbers).items():
        found = getattr(channels, name)
        assert found.shape == (2, *column.shape)
        assert found.dtype == column.dtype
        np.testing.assert_equal(found, np.full_like(found, column.missing))
