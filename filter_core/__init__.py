"""Decide which boxes the camera can see. Arrays in, numbers and verdicts out.

Start with `filter_frame`. Below it are two pure functions: `measure` reads pixels and
gives `Evidence`, numbers per box; `decide` takes evidence and a `FilterConfig` and
gives `Decisions`. Thresholds can therefore be changed without reading a pixel again.
"""

from filter_core.annotation import (
    AnnotationLimits,
    FrameAnnotation,
    frame_boxes_2d,
    parse_annotation,
)
from filter_core.boxes import correct_xyxy, to_xyxy
from filter_core.camera import Camera
from filter_core.config import ClassConfig, FilterConfig
from filter_core.config_diff import diff_configs
from filter_core.config_file import LoadedConfig, load_config
from filter_core.decide import decide
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
from filter_core.explain import explain, hidden_by
from filter_core.formats.frame_source import ReadOptions
from filter_core.formats.layouts import detect_layout, read_source
from filter_core.frame_filter import (
    FrameOptions,
    FrameResult,
    MeasuredFrame,
    filter_frame,
    measure_frame,
)
from filter_core.ignore_mask import read_ignore_mask
from filter_core.local_filter import FrameOutcome, filter_source
from filter_core.measure import FrameBoxes, MeasureOptions, measure
from filter_core.palettes import FAMILIES, Palette, family_of_version
from filter_core.projection import project_box, project_boxes
from filter_core.segmentation import (
    Segmentation,
    SegmentationOptions,
    read_segmentation,
    segmentation_from_tags,
)
from filter_core.types import BoxState, Decisions, Evidence, Reason, Verdict

__all__ = [
    "FAMILIES",
    "AnnotationError",
    "AnnotationErrors",
    "AnnotationLimits",
    "BoxState",
    "Camera",
    "ClassConfig",
    "ConfigError",
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
    "MeasureOptions",
    "MeasuredFrame",
    "NotAvailable",
    "Palette",
    "ReadOptions",
    "Reason",
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
