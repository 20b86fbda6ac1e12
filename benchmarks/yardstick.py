"""What rates and costs are compared with: OpenCV's decoder, whichever the product uses.

zlib-ng inflates a segmentation in a tenth of the time that OpenCV's zlib takes.
Compared with a decoder that uses it everything else would seem to have become more
expensive; so the yardstick stays OpenCV's, and both comparisons are printed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from filter_core.images.decoding import InflatedPng


@contextmanager
def decoding_by_opencv() -> Iterator[None]:
    """Let this process leave all decoding to OpenCV."""
    with patch.object(InflatedPng, "of", lambda *_: None):
        yield
