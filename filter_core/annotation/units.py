"""Finds rectangles whose numbers are in another unit or order than their key says.

Such a rectangle would get a verdict about other pixels than those of its object, so
the frame is refused instead, by an error that names the box, its numbers and what they
look like. Only what cannot be right is refused: a rectangle without extent, or outside
of the image, is one of the filter's own reasons to reject a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from filter_core.annotation.boxes import box_place
from filter_core.annotation.frame import BoxAnnotation, FrameAnnotation
from filter_core.geometry.boxes import FORMS, to_xyxy
from filter_core.values import Faults, Place
from filter_core.verdicts import Profile

_SHARES: Final = ("xyxyn", "cxcywhn")

_CORNERS: Final = ("xyxy", "xyxyn")

MAX_SHARE: Final = 10.0
"""No share is larger. A box that reaches out of the image may exceed 1."""

PERCENT: Final = 100.0

_EMPTY: Final = 1.0
"""Pixels; a side that is inverted by no more is one without extent.

In labels whose last pixel is included, an empty box ends one pixel before it begins.
"""


def check_units(
    annotation: FrameAnnotation, wh: tuple[int, int], profile: Profile, key: str = ""
) -> None:
    """Refuse rectangles in another unit than their form has, or with exchanged corners.

    `wh` is (width, height) of the image, px; errors name the frame by `key`. Called for
    frames that come in. Frames that are stored are not checked again. No effect in
    profile ``carlasimu``, whose code takes every number as it is.

    Raises
    ------
    AnnotationErrors
        One for each such box, with the pointer of its rectangle. ``wrong_unit``: shares
        of the image where pixels are expected, or pixels or percent where shares are;
        ``exchanged_corners``; ``negative_size``.
    """
    if profile == "carlasimu":
        return
    boxes = [box for box in annotation.boxes if box.form in FORMS]
    faults = Faults(key)
    for box in boxes:
        a, b, c, d = box.values
        if box.form in _CORNERS:
            if (c < a or d < b) and _would_be_seen(box, wh):
                faults.add(
                    _place(box),
                    "exchanged_corners",
                    "x_min <= x_max and y_min <= y_max",
                    f"{_numbers(box)}; exchange the corners, or say `boxes: {{corners: "
                    "xywh}` in a folder's recording.yaml if these are width and height",
                )
        elif (c < 0 or d < 0) and _would_be_seen(box, wh):
            expected = "a width and a height of at least 0"
            faults.add(_place(box), "negative_size", expected, _numbers(box))
    _check_shares([box for box in boxes if box.form in _SHARES], faults)
    _check_pixels([box for box in boxes if box.form not in _SHARES], faults)
    faults.raise_any()


def _would_be_seen(box: BoxAnnotation, wh: tuple[int, int]) -> bool:
    """Whether an inverted box has an area in the image in its other reading.

    One that has none is rejected either way.
    """
    first, last = to_xyxy(box.form, [box.values], wh).reshape(2, 2)
    low, high = np.minimum(first, last), np.maximum(first, last)
    if box.form == "xywh":  # its size could be meant without the sign, too
        high = np.where(last < first, 2 * high - low, high)
    shown = np.minimum(high, wh) - np.maximum(low, 0)
    return bool((shown > np.where(last < first, _EMPTY, 0)).all())


def _check_shares(boxes: Sequence[BoxAnnotation], faults: Faults) -> None:
    wrong = [box for box in boxes if max(map(abs, box.values)) > MAX_SHARE]
    if not wrong:
        return
    unit = unit_of_shares([box.values for box in boxes])
    for box in wrong:
        faults.add(
            _place(box),
            "wrong_unit",
            "shares of the image's width and height, 0 to 1",
            f"{_numbers(box)}, which looks like {unit}; {_of_folder(unit)}",
        )


def unit_of_shares(values: ArrayLike) -> str:
    """The unit that numbers look like where shares are expected, some of them large."""
    numbers = np.abs(np.asarray(values, np.float64))
    if numbers.max() > PERCENT:
        return "pixels"
    return "pixels or percent" if (numbers == np.rint(numbers)).all() else "percent"


def _check_pixels(boxes: Sequence[BoxAnnotation], faults: Faults) -> None:
    wrong = [box for box in boxes if _looks_like_shares(box)]
    if not wrong:
        return
    if not all(0 <= number <= 1 for box in boxes for number in box.values):
        # Beside boxes in pixels, one at the corner is the rest of a larger box.
        wrong = [
            box for box in wrong if to_xyxy(box.form, [box.values], (1, 1))[0, :2].any()
        ]
    for box in wrong:
        faults.add(
            _place(box),
            "wrong_unit",
            "pixels",
            f"{_numbers(box)}, which looks like shares of the image's width and "
            f"height; those belong under xyxyn or cxcywhn; {_of_folder('shares')}",
        )


def _of_folder(units: str) -> str:
    """What helps where a format fixes the key of its rectangles."""
    keys = (f"`boxes: {{unit: {unit}}}`" for unit in units.split(" or "))
    return f"in recording.yaml of a folder, {' or '.join(keys)} says so"


def _looks_like_shares(box: BoxAnnotation) -> bool:
    values = box.values
    if not all(0 <= number <= 1 for number in values):
        return False
    x_min, y_min, x_max, y_max = to_xyxy(box.form, [values], (1, 1))[0]
    has_extent = x_max > x_min and y_max > y_min
    return bool(has_extent) and not all(map(float.is_integer, values))


def _place(box: BoxAnnotation) -> Place:
    return box_place(box.index, {"id": box.id}) / box.form


def _numbers(box: BoxAnnotation) -> str:
    return f"[{', '.join(f'{number:.10g}' for number in box.values)}]"
