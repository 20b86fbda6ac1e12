"""How large a frame is, if all that say so agree."""

from __future__ import annotations

from filter_core.annotation.frame import FrameAnnotation
from filter_core.errors import ImageSizeMismatch
from filter_core.segmentation.pixel_codes import Segmentation


def agreed_size(
    annotation: FrameAnnotation,
    segmentation: Segmentation | None,
    image_wh: tuple[int, int] | None,
) -> tuple[int, int]:
    """Width and height, px, of the image, the segmentation and the camera alike.

    Raises
    ------
    ImageSizeMismatch
        Two of them differ; ``image_size_unknown``: none of them is there.
    """
    tags_wh = (segmentation.width, segmentation.height) if segmentation else None
    sizes = {
        "the image": image_wh,
        "the segmentation": tags_wh,
        "the camera": annotation.camera_wh,
    }
    known = [(name, wh) for name, wh in sizes.items() if wh is not None]
    if not known:
        raise ImageSizeMismatch(
            "expected the size of the image from an image, a segmentation or the "
            "camera, found none of them",
            code="image_size_unknown",
        )
    first, size = known[0]
    for name, wh in known[1:]:
        if wh != size:
            raise ImageSizeMismatch(
                f"{name}: expected {size[0]} x {size[1]} px, as {first}, "
                f"found {wh[0]} x {wh[1]} px",
                pointer=name.replace("the ", "/"),
            )
    return size
