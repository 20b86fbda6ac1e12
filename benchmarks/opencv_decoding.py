"""Decodes by OpenCV alone: the reference with which rates and costs are compared.

The product inflates PNGs by zlib-ng, in a tenth of the time that OpenCV's zlib takes.
Compared with that, all other work would seem to have become more expensive. So the
reference stays OpenCV's own decoder, and both comparisons are printed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from filter_core.images.decoding import InflatedPng


@contextmanager
def decoding_by_opencv() -> Iterator[None]:
    """Decode all images in this process by OpenCV alone."""
    with patch.object(InflatedPng, "of", lambda *_: None):
        yield
