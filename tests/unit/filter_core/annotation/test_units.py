"""Rectangles in another unit than their key says are refused by what they look like."""

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import AnnotationErrors
from filter_core.pipeline import filter_frame

WIDTH, HEIGHT = 640, 360
TAGS = np.zeros((HEIGHT, WIDTH), np.uint8)
TAGS[180:223, 186:260] = 14
CORNERS = [186, 180, 260, 223]
SHARES = [186 / WIDTH, 180 / HEIGHT, 260 / WIDTH, 223 / HEIGHT]
PERCENT = [100 * share for share in SHARES]


def decide(*boxes, **settings):
    """Decisions of boxes given as (form, values), in an image of one car."""
    config = FilterConfig(**settings)
    annotation = {
        "carla_version": "0.9.15",
        "boxes": [{"class": "car", form: values} for form, values in boxes],
    }
    return filter_frame(annotation, TAGS, config).decisions


def faults(*boxes):
    """(code, pointer) of each fault, and the text of all."""
    with pytest.raises(AnnotationErrors) as caught:
        decide(*boxes, profile="paper")
    errors = caught.value.errors
    return [(error.kind, error.pointer) for error in errors], str(errors[0])


@pytest.mark.parametrize(
    ("form", "values", "code", "words"),
    [
        ("xyxy", SHARES, "wrong_unit", "shares of the image's width and height"),
        ("xywh", [0.29, 0.5, 0.116, 0.12], "wrong_unit", "under xyxyn or cxcywhn"),
        ("cxcywh", [0.35, 0.56, 0.116, 0.12], "wrong_unit", "looks like shares"),
        ("xyxy", [0, 0.5, 0.4, 1], "wrong_unit", "looks like shares"),
        ("xyxy", [0, 0, 0.4, 0.5], "wrong_unit", "looks like shares"),
        ("xyxyn", CORNERS, "wrong_unit", "looks like pixels"),
        ("xyxyn", PERCENT, "wrong_unit", "looks like percent"),
        ("xyxyn", [20, 30, 40, 50], "wrong_unit", "looks like pixels or percent"),
        ("xyxyn", [0, 0, 300, 200], "wrong_unit", "looks like pixels"),
        ("cxcywhn", [223, 201.5, 74, 43], "wrong_unit", "looks like pixels"),
        ("xyxy", [260, 223, 186, 180], "exchanged_corners", "[260, 223, 186, 180]"),
        ("xyxy", [260, 180, 186, 223], "exchanged_corners", "x_min <= x_max"),
        ("xyxy", [186, 223, 260, 180], "exchanged_corners", "y_min <= y_max"),
        ("xyxyn", [0.4, 0.6, 0.3, 0.5], "exchanged_corners", "[0.4, 0.6, 0.3, 0.5]"),
        ("xywh", [260, 223, -74, -43], "negative_size", "at least 0"),
        ("xywh", [0, 223, -74, 43], "negative_size", "at least 0"),
        ("cxcywh", [223, 201, -74, 43], "negative_size", "[223, 201, -74, 43]"),
        ("cxcywhn", [0.3, 0.5, 0.1, -0.1], "negative_size", "at least 0"),
    ],
)
def test_wrong_unit_is_named_with_the_box_and_its_numbers(form, values, code, words):
    kinds, text = faults((form, values))

    assert kinds == [(code, f"/boxes/0/{form}")]
    assert words in text
    assert text.startswith(f'box 0 (id "0"), {form}: expected ')


def test_wrong_boxes_among_right_ones_are_named():
    kinds, _ = faults(
        ("xyxy", CORNERS), ("xyxy", SHARES), ("xyxyn", SHARES), ("xyxyn", CORNERS)
    )

    assert kinds == [("wrong_unit", "/boxes/3/xyxyn"), ("wrong_unit", "/boxes/1/xyxy")]


@pytest.mark.parametrize(
    ("box", "reason"),
    [
        (("xyxy", [186, 180, 186, 223]), "degenerate"),
        (("xywh", [186, 180, 0, 43]), "degenerate"),
        (("xyxy", [186, 180, 185, 179]), "degenerate"),  # inclusive and empty
        (("xyxy", [650, 180, 640, 223]), "outside_image"),  # clamped on one side only
        (("xywh", [-1, -1, -1, -1]), "outside_image"),
        (("xyxy", [0, 0, 1, 1]), "no_visible_pixels"),
        (("xyxyn", [-1.5, 0.2, 9.5, 0.8]), "visible"),  # reaches out of the image
        (("xyxyn", [1.2, 0.2, 2, 0.8]), "outside_image"),
        (("cxcywhn", [0.5, 0.5, 0, 0]), "degenerate"),
    ],
)
def test_rectangles_that_may_be_meant_are_decided(box, reason):
    (decision,) = decide(box, threshold_small_box=1, threshold_big_box=1)

    assert decision["reason"] == reason


def test_what_may_be_meant_depends_on_other_boxes_and_on_the_profile():
    # The rest of a box in the first pixel: that it is in pixels, the other box shows.
    boxes = ("xyxy", [0, 0, 0.6, 0.4]), ("xyxy", CORNERS)
    first, _ = decide(*boxes, profile="paper")
    (exchanged,) = decide(("xyxy", [260, 223, 186, 180]), profile="carlasimu")

    assert first["reason"] == "no_visible_pixels"
    assert exchanged["reason"] == "degenerate"
