"""Several sources may say how to read a segmentation; contradictions are refused."""

import numpy as np
import pytest

from filter_core.errors import SegmentationError
from filter_core.segmentation.reading import SegmentationOptions, read_segmentation
from tests.support.pictures import FAMILY, painted, png, tag_image

STREET = tag_image("sss", ".cc", "tt.")


def test_agreeing_option_sources_are_merged_and_contradicting_ones_named():
    joined = SegmentationOptions.agreed(
        {
            "the dataset": SegmentationOptions(palette=FAMILY),
            "the config": SegmentationOptions(palette=FAMILY, lossy="nearest"),
            "the frame": SegmentationOptions(carla_version="0.9.15"),
        }
    )

    assert (joined.palette, joined.lossy) == (FAMILY, "nearest")
    assert (joined.channel_order, joined.carla_version) == ("auto", "0.9.15")
    layers = {
        "the dataset": SegmentationOptions(channel_order="rgb"),
        "the config": SegmentationOptions(channel_order="bgr"),
    }

    with pytest.raises(SegmentationError) as caught:
        SegmentationOptions.agreed(layers)

    assert caught.value.kind == "segmentation_contradiction"
    assert str(caught.value) == (
        "the dataset says channel_order rgb, the config says bgr"
    )


CONTRADICTIONS = {
    "palette and version": (
        png(painted(STREET)),
        SegmentationOptions(palette="carla-0.9.14", carla_version="0.9.12"),
        r"the caller says palette carla-0\.9\.14, "
        r"carla_version 0\.9\.12 renders carla-0\.9\.10",
    ),
    "version and colours": (
        png(painted(STREET)),
        SegmentationOptions(carla_version="0.9.12"),
        r"carla_version 0\.9\.12 says palette carla-0\.9\.10, the colours that "
        r"occur prove carla-0\.9\.14: \(0, 0, 70\) is Truck there",
    ),
    "palette and raw tags": (
        png(np.full((4, 4), 25, np.uint8)),
        SegmentationOptions(palette="carla-0.9.10", sources={"palette": "the dataset"}),
        r"the dataset says palette carla-0\.9\.10, the raw tag 25 that occurs "
        r"proves carla-0\.9\.14",
    ),
    "order and raw channel": (
        png(np.dstack([STREET * 0, STREET * 0, STREET])),
        SegmentationOptions(encoding="raw", channel_order="rgb", palette=FAMILY),
        "channel_order rgb, but the raw tags are in the blue channel alone",
    ),
    "encoding and form": (
        png(STREET),
        SegmentationOptions(encoding="palette"),
        "the caller says encoding palette, the image is grey",
    ),
}


@pytest.mark.parametrize(
    ("content", "options", "message"), CONTRADICTIONS.values(), ids=CONTRADICTIONS
)
def test_contradicting_options_or_image_raise_error_naming_both(
    content, options, message
):
    with pytest.raises(SegmentationError, match=message) as caught:
        read_segmentation(content, options)

    assert caught.value.kind == "segmentation_contradiction"


def test_version_yields_to_the_papers_table_and_to_colours_if_it_is_unknown():
    table = SegmentationOptions(palette="paper-table1", carla_version="0.9.15")
    unknown = SegmentationOptions(carla_version="nightly")

    of_table, of_colours = (
        read_segmentation(png(painted(STREET)), options) for options in (table, unknown)
    )

    assert (of_table.family, of_colours.family) == ("paper-table1", FAMILY)
    assert "found 'nightly'; not used" in of_colours.notes[-1]
