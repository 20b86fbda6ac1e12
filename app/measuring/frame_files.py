"""Measures one frame from the bytes of its files, in a child process.

The bytes are untrusted, and so is the cost of decoding them (`app.engine.children`). A
thread of the service measures only frames that are `is_simple`.
"""

from __future__ import annotations

import threading
import time
from base64 import b64decode
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from app.engine.children import PixelPool
from app.metrics import DECODE_SECONDS, MEASURE_SECONDS
from filter_core.annotation.frame import FrameAnnotation
from filter_core.config.measure import MeasureConfig
from filter_core.errors import error_context
from filter_core.evidence_kinds import CHANNELS, files_for
from filter_core.geometry.boxes import FORMS
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.images.png import SIGNATURE, read_png
from filter_core.pipeline import FrameOptions, MeasuredFrame, measure_frame
from filter_core.segmentation.reading import read_segmentation

MEASURED: Final = ("segmentation", "ignore_mask")
"""The kinds of files that every measurement reads."""
SENSORS: Final = files_for(CHANNELS)
"""The kinds of files that channels other than the segmentation read."""
SIMPLE_PIXELS: Final = 1 << 21
"""More than 1920 x 1080. The slowest picture takes some tenths of a second."""
SIMPLE_BOXES: Final = 1000
_SECOND_KIND: Final = slice(37, 41)
"""Position of the type of a PNG's second chunk, the one after the header."""
_BITS: Final = 8


@dataclass(frozen=True)
class FrameFiles:
    """The files of a frame that are measured."""

    segmentation: bytes | None
    image_wh: tuple[int, int]
    ignore_mask: bytes | None = None
    sensors: Mapping[str, bytes] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        contents: Mapping[str, bytes],
        image_wh: tuple[int, int],
        kinds: tuple[str, ...] = SENSORS,
    ) -> FrameFiles:
        """From files by kind; `kinds` are the sensors whose files are included."""
        sensors = {kind: contents[kind] for kind in kinds if kind in contents}
        segmentation, ignore_mask = map(contents.get, MEASURED)
        return cls(segmentation, image_wh, ignore_mask, sensors=sensors)


def measure_files(
    pool: PixelPool,
    plan: MeasureConfig,
    annotation: FrameAnnotation,
    files: FrameFiles,
    cancelled: threading.Event | None = None,
) -> MeasuredFrame:
    """Decode, project and measure one frame.

    A child process does it while this thread waits. A frame that is known to be cheap
    (`is_simple`) is measured in this thread. Raises FilterError: the frame is invalid;
    `app.engine.children.PixelsRefused` if it needs more time or memory than allowed;
    app.engine.children.CallCancelled: `cancelled` was set before the child was done.
    """
    # The child gets only the fields that it reads.
    needed = replace(annotation, raw={})
    work = measure, plan, needed, files
    if is_simple(plan, needed, files):
        measured, decode_s, measure_s = pool.run_here(*work)
    else:
        measured, decode_s, measure_s = pool.run(*work, cancelled=cancelled)
    if decode_s is not None:
        DECODE_SECONDS.observe(decode_s)
    MEASURE_SECONDS.observe(measure_s)
    return replace(measured, annotation=annotation)


def is_simple(
    config: MeasureConfig, annotation: FrameAnnotation, files: FrameFiles
) -> bool:
    """Whether measuring a frame is cheap, regardless of its bytes.

    True for a PNG of eight bits per channel that is not interlaced, has no chunk
    between its header and its pixels, and at most `SIMPLE_PIXELS`, with at most
    `SIMPLE_BOXES` boxes that have no order, and no other picture to be read: as CARLA
    and OpenCV write segmentations. Its pixels are inflated to the size in the header; a
    file with more is refused (`filter_core.images.decoding`). Raises ImageError: the
    PNG is damaged.
    """
    content = files.segmentation
    others = {*config.files} & files.sensors.keys()
    is_alone = not (others or config.ignored or files.ignore_mask)
    if "ordered" in config.channels:
        is_alone &= all(
            box.distance is None and box.form in FORMS for box in annotation.boxes
        )
    if content is None or not is_alone or len(annotation.boxes) > SIMPLE_BOXES:
        return False
    if content[:8] != SIGNATURE or content[_SECOND_KIND] != b"IDAT":
        return False
    png = read_png(content, whole=False)
    is_plain = png.bit_depth == _BITS and not png.is_interlaced
    return is_plain and png.width * png.height <= SIMPLE_PIXELS


def measure(
    config: MeasureConfig, annotation: FrameAnnotation, files: FrameFiles
) -> tuple[MeasuredFrame, float | None, float]:
    """Decode, project and measure one frame; raises FilterError if it is invalid.

    With the seconds of decoding (None: there was nothing to decode) and of measuring.
    """
    begun, decoding = time.perf_counter(), None
    segmentation = None
    if files.segmentation is not None:
        segmentation = read_segmentation(
            files.segmentation,
            replace(config.reading, carla_version=annotation.carla_version),
            expected_wh=files.image_wh,
        )
        decoding = time.perf_counter() - begun
    masks = [] if files.ignore_mask is None else [files.ignore_mask]
    if config.ignored is not None:
        picture = config.ignored.get("png")
        masks.append(b64decode(picture) if picture else config.ignored["polygons"])
    ignore = None
    if masks:
        with error_context(pointer="/ignore_mask"):
            read = [read_ignore_mask(mask, files.image_wh) for mask in masks]
        ignore = np.logical_or.reduce(read)
    options = FrameOptions(
        image_wh=files.image_wh, ignore=ignore, sensors=files.sensors
    )
    begun = time.perf_counter()
    measured = measure_frame(annotation, segmentation, config, options)
    return measured, decoding, time.perf_counter() - begun
