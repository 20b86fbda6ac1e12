"""What rates and costs are compared with: OpenCV's decoder, whichever the product uses.

With imagecodecs (`unghost[fast]`) a segmentation is decoded in about half the time.
Compared with that decoder everything else would seem to have become more expensive; so
the yardstick stays the decoder that every installation has, and both comparisons are
printed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from filter_core import color_decoding
from filter_core.color_decoding import png_decoder


@contextmanager
def decoding_by_opencv() -> Iterator[None]:
    """Let this process decode as without imagecodecs."""
    with patch.object(color_decoding, "png_decoder", lambda: None):
        yield


def decoder_in_use() -> str:
    """Which library decodes PNGs here."""
    return "OpenCV" if png_decoder() is None else "imagecodecs"
