"""A rendered frame of the demo street whose PNG files are decoded when first used."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.classes import accept_mask_of
from unghost.street.street import StreetFrame


@dataclass(eq=False)
class DecodedFrame:
    """The decoded images, annotation and rectangles of one frame."""

    frame: StreetFrame

    @cached_property
    def image(self):
        return _decoded(self.frame.image_png)

    @cached_property
    def segmentation(self):
        return _decoded(self.frame.segmentation_png)

    @cached_property
    def instances(self):
        """Two images: semantic tags (red), and instance numbers (green + 256 blue)."""
        rgb = _decoded(self.frame.instances_png).astype(np.int32)
        return rgb[..., 0].astype(np.uint8), rgb[..., 1] + 256 * rgb[..., 2]

    @cached_property
    def depth(self):
        """Metres, from 24 bits of which red holds the lowest and blue the highest."""
        rgb = _decoded(self.frame.depth_png).astype(np.float64)
        steps = rgb[..., 0] + 256 * rgb[..., 1] + 65536 * rgb[..., 2]
        return steps * (1000.0 / ((1 << 24) - 1))

    @cached_property
    def annotation(self):
        return parse_annotation(self.frame.annotation)

    @cached_property
    def geometry(self):
        return frame_boxes_2d(self.annotation, (1280, 720))

    @cached_property
    def places(self):
        """The flat indexes of each instance's pixels, found once for all boxes."""
        flat = self.instances[1].ravel()
        order = np.argsort(flat, kind="stable")
        numbers, starts = np.unique(flat[order], return_index=True)
        parts = np.split(order, starts[1:])
        return dict(zip(numbers.tolist(), parts, strict=True))

    def pixels_of(self, number):
        """Rows and columns of the pixels of an instance."""
        places = self.places.get(number, np.zeros(0, np.int64))
        return np.unravel_index(places, self.instances[1].shape)

    def own_pixels(self, line):
        """Rows and columns of the pixels that should count for one line of the truth.

        They belong to its instance, and have a tag that its class accepts.
        """
        row, column = self.pixels_of(line["instance"])
        accepted = accept_mask_of(line["class"], "carla-0.9.14")
        own = (accepted >> self.instances[0][row, column].astype(int)) & 1 == 1
        return row[own], column[own]


def _decoded(png):
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    return np.asarray(image)[..., ::-1]
