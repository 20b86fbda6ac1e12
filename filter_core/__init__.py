"""Decides which boxes are visible to the camera. Arrays in, numbers and verdicts out.

Start with `filter_frame`. Below it are two pure functions: `measure` reads pixels and
gives `Evidence`, numbers per box; `decide` takes evidence and a `FilterConfig` and
gives `Decisions`. Thresholds can therefore be changed without reading a pixel again.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from filter_core.annotation.frame import (
    AnnotationLimits,
    FrameAnnotation,
    frame_boxes_2d,
)
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.file import LoadedConfig, load_config
from filter_core.config.filter import (
    ClassConfig,
    DecideConfig,
    FilterConfig,
    diff_configs,
)
from filter_core.config.measure import MeasureConfig
from filter_core.decisions.explain import explain, hidden_by
from filter_core.decisions.rules import decide
from filter_core.errors import (
    AnnotationError,
    AnnotationErrors,
    ConfigError,
    FilterError,
    ImageError,
    ImageSizeMismatch,
    ImageTooLarge,
    LayoutError,
    NotAvailable,
    SegmentationError,
)
from filter_core.evidence.semantic import MeasureOptions, measure
from filter_core.evidence_numbers import BoxState, Evidence
from filter_core.frame_boxes import FrameBoxes
from filter_core.geometry.boxes import correct_xyxy, to_xyxy
from filter_core.geometry.camera import Camera
from filter_core.geometry.projection import project_box, project_boxes
from filter_core.images.ignore_mask import read_ignore_mask
from filter_core.pipeline import (
    FrameOptions,
    FrameResult,
    MeasuredFrame,
    filter_frame,
    measure_frame,
)
from filter_core.segmentation.codes import Segmentation
from filter_core.segmentation.palettes import FAMILIES, Palette, family_of_version
from filter_core.segmentation.reading import (
    SegmentationOptions,
    read_segmentation,
    segmentation_from_tags,
)
from filter_core.verdicts import Decisions, Reason, Verdict

if TYPE_CHECKING:
    from filter_core.formats.recording import RecordingDescription
    from filter_core.formats.registry import detect_layout, read_source
    from filter_core.local import FrameOutcome, filter_source

__all__ = [
    "FAMILIES",
    "AnnotationError",
    "AnnotationErrors",
    "AnnotationLimits",
    "BoxState",
    "Camera",
    "ClassConfig",
    "ConfigError",
    "DecideConfig",
    "Decisions",
    "Evidence",
    "FilterConfig",
    "FilterError",
    "FrameAnnotation",
    "FrameBoxes",
    "FrameOptions",
    "FrameOutcome",
    "FrameResult",
    "ImageError",
    "ImageSizeMismatch",
    "ImageTooLarge",
    "LayoutError",
    "LoadedConfig",
    "MeasureConfig",
    "MeasureOptions",
    "MeasuredFrame",
    "NotAvailable",
    "Palette",
    "Reason",
    "RecordingDescription",
    "Segmentation",
    "SegmentationError",
    "SegmentationOptions",
    "Verdict",
    "correct_xyxy",
    "decide",
    "detect_layout",
    "diff_configs",
    "explain",
    "family_of_version",
    "filter_frame",
    "filter_source",
    "frame_boxes_2d",
    "hidden_by",
    "load_config",
    "measure",
    "measure_frame",
    "parse_annotation",
    "project_box",
    "project_boxes",
    "read_ignore_mask",
    "read_segmentation",
    "read_source",
    "segmentation_from_tags",
    "to_xyxy",
]

_OF_FOLDERS = {
    "FrameOutcome": "filter_core.local",
    "RecordingDescription": "filter_core.formats.recording",
    "detect_layout": "filter_core.formats.registry",
    "filter_source": "filter_core.local",
    "read_source": "filter_core.formats.registry",
}
"""Names that are imported on first use, and their modules.

Filtering single frames needs no readers of folders and no formats, whose import takes a
fifth of the library's import time.
"""


def __getattr__(name: str) -> object:
    if name not in _OF_FOLDERS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    attribute: object = getattr(import_module(_OF_FOLDERS[name]), name)
    return attribute
