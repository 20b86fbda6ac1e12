"""What rates and costs are compared with: OpenCV's decoder, whichever the product uses.

With imagecodecs (`unghost[fast]`) a segmentation is decoded in a quarter of the time.
Compared with that decoder everything else would seem to have become more expensive; so
the yardstick stays the decoder that every installation has, and both comparisons are
printed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from filter_core import png_decoding
from filter_core.png_decoding import png_codecs


@contextmanager
def decoding_by_opencv() -> Iterator[None]:
    """Let this process decode as without imagecodecs."""
    with patch.object(png_decoding, "png_codecs", lambda: None):
        yield


def decoder_in_use() -> str:
    """Which library decodes PNGs here."""
    return "OpenCV" if png_codecs() is None else "imagecodecs"
