"""Reading segmentations of every encoding, and refusing those that are unreliable."""

import numpy as np
import pytest

from filter_core.errors import (
    FilterError,
    ImageError,
    ImageSizeMismatch,
    ImageTooLarge,
    SegmentationError,
)
from filter_core.evidence.semantic import measure
from filter_core.segmentation.palettes import FAMILIES, UnknownFamily
from filter_core.segmentation.reading import (
    Encoding,
    SegmentationOptions,
    read_segmentation,
    segmentation_from_tags,
)
from tests.support.pictures import (
    FAMILY,
    frame_boxes,
    indexed_png,
    jpeg,
    painted,
    pixels_of,
    png,
    tag_image,
    with_alpha,
)
from tests.support.sensors import depth_png, instance_png, street_metres

STREET = tag_image("sssvvvvs", "ssvvvvvs", "..ccc.w.", "..ccctw.", "....tt..")
LARGE_STREET = np.kron(STREET, np.ones((16, 16), np.uint8))
METRES = street_metres()
NO_PALETTE = SegmentationOptions(palette="carla-0.9.15")
TERRAIN_BEFORE_0_9_14 = (145, 170, 100)


def rows(*rgb: tuple[int, int, int], width: int = 10) -> np.ndarray:
    """An image with one row of each colour."""
    return np.repeat(np.array(rgb, np.uint8)[:, None, :], width, axis=1)


def lane_lines(family: str, width: int, height: int) -> np.ndarray:
    """Raw tags of a road to the horizon, with lines of one pixel."""
    tag_of = FAMILIES[family].tag_of
    tags = np.zeros((height, width), np.uint8)
    horizon = height * 45 // 100
    tags[horizon // 3 : horizon, : width // 3] = tag_of("Building")
    tags[horizon // 4 : horizon, width * 3 // 5 :] = tag_of("Vegetation")
    tags[horizon // 3 : horizon + 8, width // 5 : width // 5 + 2] = tag_of("Pole")
    tags[horizon:] = tag_of("Sidewalk")
    for y in range(horizon, height):
        half = 4 + (y - horizon) / (height - horizon) * width * 0.42
        left, right = int(width / 2 - half), int(width / 2 + half)
        tags[y, max(0, left) : right] = tag_of("Road")
        for share in (0, 0.3, 0.7, 1):
            if share in (0, 1) or y // 6 % 2:
                tags[y, round(left + share * (right - left))] = tag_of("RoadLine")
    tags[horizon + 6 : horizon + 26, width // 2 + 20 :][:, :40] = tag_of("Vehicle")
    return tags


def every_tag(family: str) -> np.ndarray:
    return np.arange(len(FAMILIES[family].tags), dtype=np.uint8).reshape(1, -1)


CONTENT = png(painted(np.tile(STREET, (9, 9))))
DAMAGED = CONTENT[:60] + bytes(20) + CONTENT[80:]

FORMS = {
    "RGB": lambda tags, family: png(painted(tags, family)),
    "RGB swapped": lambda tags, family: png(painted(tags, family), order="bgr"),
    "RGBA": lambda tags, family: png(with_alpha(painted(tags, family))),
    "RGBA, transparent": lambda tags, family: png(with_alpha(painted(tags, family), 0)),
    "indexed": lambda tags, family: indexed_png(tags, FAMILIES[family].rgb_table),
}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("family", FAMILIES)
def test_palette_image_is_recognised_and_decoded_exactly(family, form):
    tags = np.repeat(every_tag(family), 3, axis=0)

    segmentation = read_segmentation(FORMS[form](tags, family))

    order = "bgr" if "swapped" in form else "rgb"
    assert (segmentation.family, segmentation.encoding) == (family, "palette")
    assert (segmentation.channel_order, segmentation.unknown_pixels) == (order, 0)
    np.testing.assert_array_equal(segmentation.tags, tags)


RAW = {
    "grey": lambda tags: png(tags),
    "red": lambda tags: png(np.dstack([tags, tags * 0, tags * 0])),
    "red and alpha": lambda tags: png(
        with_alpha(np.dstack([tags, tags * 0, tags * 0]))
    ),
    "blue": lambda tags: png(np.dstack([tags * 0, tags * 0, tags])),
}


@pytest.mark.parametrize("form", RAW)
def test_raw_tags_are_read_with_the_family_of_carla_version(form):
    options = SegmentationOptions(carla_version="0.9.15")

    segmentation = read_segmentation(RAW[form](STREET), options)

    order = "bgr" if form == "blue" else "rgb"
    assert (segmentation.family, segmentation.encoding) == (FAMILY, "raw")
    assert segmentation.channel_order == order
    np.testing.assert_array_equal(segmentation.tags, STREET)


@pytest.mark.parametrize("form", RAW)
@pytest.mark.parametrize(
    ("version", "words"),
    [
        (None, "Name the palette"),
        ("nightly", r"as in 0\.9\.15; found 'nightly'; not used$"),
    ],
)
def test_raw_tags_without_palette_or_known_version_are_refused(form, version, words):
    options = SegmentationOptions(carla_version=version)

    with pytest.raises(SegmentationError, match=words) as caught:
        read_segmentation(RAW[form](STREET), options)

    assert caught.value.kind == "family_not_named"


@pytest.mark.parametrize("tag", [23, 28, 29])
def test_raw_tags_from_23_on_prove_the_newest_family(tag):
    tags = STREET.copy()
    tags[0, 0] = tag

    assert read_segmentation(png(tags)).family == "carla-0.9.14"


def test_instance_image_is_read_as_raw_tags_of_its_red_channel():
    identity = np.arange(STREET.size, dtype=np.uint8).reshape(STREET.shape)
    instances = np.dstack([STREET, identity, identity])
    options = SegmentationOptions(encoding="raw", palette=FAMILY)

    segmentation = read_segmentation(png(instances), options)

    np.testing.assert_array_equal(segmentation.tags, STREET)


def test_tags_of_no_family_are_unknown_up_to_one_percent():
    tags = np.full((10, 10), 14, np.uint8)
    tags[0, 0] = 99

    segmentation = read_segmentation(png(tags), SegmentationOptions(palette=FAMILY))

    assert (segmentation.unknown_pixels, segmentation.tags[0, 0]) == (1, 255)
    assert segmentation.notes == (
        "1.00 % of the pixels have tags that carla-0.9.14 does not have; "
        "counted as Unknown",
    )


def test_colours_of_another_family_are_unknown_counted_and_noted():
    rgb = painted(np.tile(every_tag(FAMILY), (10, 1)))
    rgb[0, :6] = TERRAIN_BEFORE_0_9_14

    segmentation = read_segmentation(png(rgb))

    assert segmentation.unknown_pixels == 6
    assert segmentation.unknown_percent == 2.0
    assert (segmentation.tags[0, :6] == 255).all()
    assert segmentation.notes == (
        "2.00 % of the pixels are (145, 170, 100), Terrain of carla-0.9.10; "
        "counted as Unknown",
    )


@pytest.mark.parametrize(
    "rgb",
    [
        pytest.param((1, 2, 3), id="unlike any"),
        pytest.param((0, 0, 141), id="one level off Car in blue"),
        pytest.param((0, 1, 142), id="one level off Car in green"),
    ],
)
def test_colours_of_no_family_are_unknown_up_to_one_percent(rgb):
    picture = painted(np.full((10, 10), 15, np.uint8))
    picture[3, 3] = rgb

    segmentation = read_segmentation(png(picture))

    assert segmentation.unknown_pixels == 1
    assert segmentation.tags[3, 3] == 255
    assert "1.00 % of the pixels have colours of no family" in segmentation.notes[-1]


def test_over_one_percent_of_colours_of_no_family_is_refused():
    rgb = painted(np.full((10, 10), 15, np.uint8))
    rgb[3, :2] = (1, 2, 3)

    with pytest.raises(SegmentationError) as caught:
        read_segmentation(png(rgb))

    assert caught.value.kind == "foreign_colors"
    assert str(caught.value).startswith(
        "2.0 % of the pixels have colours of no known family, most often (1, 2, 3); "
        "at most 1 % may."
    )
    # A colour that is known only with swapped channels is of no family, either.
    swapped = rows(*[(0, 0, 142), (0, 0, 70), (255, 0, 0)] * 7, (142, 0, 0))
    with pytest.raises(SegmentationError, match=r"most often \(142, 0, 0\)"):
        read_segmentation(png(swapped))


class TestLossy:
    NEAREST = SegmentationOptions(lossy="nearest")

    def test_jpeg_is_read_by_the_nearest_colour_if_configured(self):
        with pytest.raises(SegmentationError, match="lossy_segmentation: nearest") as e:
            read_segmentation(jpeg(painted(LARGE_STREET)))
        assert e.value.kind == "lossy_segmentation"
        assert not read_segmentation(png(painted(STREET)), self.NEAREST).lossy

        segmentation = read_segmentation(jpeg(painted(LARGE_STREET)), self.NEAREST)

        assert (segmentation.family, segmentation.lossy) == (FAMILY, True)
        # Chroma is stored at half the resolution, so edges are lost.
        assert (segmentation.tags == LARGE_STREET)[4:-4].mean() > 0.85
        assert "lossy: tags by the nearest colour" in segmentation.notes[-1]

    @pytest.mark.parametrize(
        ("rgb", "tag"),
        [
            pytest.param((0, 0, 142), 14, id="exactly a colour"),
            pytest.param((184, 219, 184), 10, id="32 levels off in every channel"),
            pytest.param((33, 0, 142), 255, id="33 levels off in one"),
            pytest.param((0, 71, 100), 17, id="between Bus and Train, nearer to Train"),
            pytest.param((0, 70, 100), 16, id="as near to Bus as to Train"),
            pytest.param(TERRAIN_BEFORE_0_9_14, 255, id="another family's exactly"),
        ],
    )
    def test_a_pixel_gets_the_nearest_tag_within_32_levels(self, rgb, tag):
        picture = rows(*[(0, 0, 142), (0, 0, 70), (152, 251, 152)] * 30, (9, 9, 9), rgb)

        segmentation = read_segmentation(png(picture), self.NEAREST)

        assert segmentation.lossy
        assert (segmentation.tags[-1] == tag).all()
        assert segmentation.unknown_pixels == (10 if tag == 255 else 0)

    @pytest.mark.parametrize("lossy", ["refuse", "nearest"])
    @pytest.mark.parametrize("write", [jpeg, png])
    @pytest.mark.parametrize(
        "picture",
        [
            pytest.param(
                rows((200, 200, 100), (90, 200, 200), (20, 90, 150)), id="photo"
            ),
            pytest.param(pixels_of(depth_png(METRES))[..., ::-1], id="depth"),
            pytest.param(
                np.dstack([np.minimum(METRES, 255).astype(np.uint8)] * 3),
                id="grey depth",
            ),
            pytest.param(
                pixels_of(instance_png(LARGE_STREET, LARGE_STREET * 4001.0))[..., ::-1],
                id="instances",
            ),
        ],
    )
    def test_image_of_another_sensor_is_refused_without_a_remedy(
        self, picture, write, lossy
    ):
        with pytest.raises(SegmentationError, match=r"\(at most") as caught:
            read_segmentation(write(picture), SegmentationOptions(lossy=lossy))

        assert caught.value.kind == "foreign_colors"
        assert "nearest" not in str(caught.value)
        assert "encoding: raw" not in str(caught.value)

    @pytest.mark.parametrize("lossy", ["refuse", "nearest"])
    @pytest.mark.parametrize("channels", [[0], [2], [0, 1, 2]])
    @pytest.mark.parametrize("quality", [95, 75])
    def test_raw_tags_that_were_a_jpeg_are_refused_by_that_name(
        self, channels, quality, lossy
    ):
        # At edges between the blocks of a JPEG are no ripples.
        tags = LARGE_STREET[3:, 5:]
        picture = np.zeros((*tags.shape, 3), np.uint8)
        picture[..., channels] = tags[..., None]
        lost = jpeg(picture, quality)
        rgb = pixels_of(lost)[..., ::-1]
        grey = rgb[..., channels[0]]

        files: list[tuple[bytes, Encoding]] = [
            (lost, "auto"),
            (png(rgb), "auto"),
            (png(rgb), "raw"),
            (png(rgb), "palette"),
            (png(grey), "auto"),
        ]
        for content, encoding in files:
            options = SegmentationOptions(
                "carla-0.9.14", encoding=encoding, lossy=lossy
            )
            with pytest.raises(SegmentationError, match="raw tags in a JPEG") as caught:
                read_segmentation(content, options)

            assert caught.value.kind == "lossy_segmentation"
            assert "nearest" not in str(caught.value)

    def test_raw_tags_of_neighbouring_numbers_are_no_ripples(self):
        tags = np.kron(np.indices((20, 30)).sum(axis=0) % 2 + 1, np.ones((4, 4)))
        options = SegmentationOptions("carla-0.9.14")

        segmentation = read_segmentation(png(tags.astype(np.uint8)), options)

        assert set(np.unique(segmentation.tags)) == {1, 2}

    @pytest.mark.parametrize("family", ["carla-0.9.0", "carla-0.9.10"])
    @pytest.mark.parametrize("channels", [[0], [0, 1, 2]])
    @pytest.mark.parametrize("wh", [(160, 90), (320, 180), (400, 300)])
    def test_thin_lines_of_neighbouring_tags_are_no_ripples(self, family, channels, wh):
        tags = lane_lines(family, *wh)
        picture = np.zeros((*tags.shape, 3), np.uint8)
        picture[..., channels] = tags[..., None]

        for content in (png(picture), png(tags)):
            options = SegmentationOptions(family, encoding="raw")
            segmentation = read_segmentation(content, options)

            np.testing.assert_array_equal(segmentation.tags, tags)

    @pytest.mark.parametrize("quality", [75, 90, 95])
    @pytest.mark.parametrize("wh", [(160, 90), (400, 300)])
    def test_thin_lines_that_were_a_jpeg_are_refused(self, quality, wh):
        tags = lane_lines("carla-0.9.10", *wh)
        lost = pixels_of(jpeg(np.dstack([tags] * 3), quality))
        options = SegmentationOptions("carla-0.9.10", encoding="raw")

        with pytest.raises(SegmentationError, match="raw tags in a JPEG"):
            read_segmentation(png(lost), options)

    @pytest.mark.parametrize(
        ("picture", "encoding"),
        [(painted(STREET), "raw"), (np.dstack([STREET] * 3), "raw")],
        ids=["coloured", "grey in three channels"],
    )
    def test_lossy_raw_tags_are_refused(self, picture, encoding):
        options = SegmentationOptions(lossy="nearest", encoding=encoding)

        with pytest.raises(SegmentationError, match="one level off is another tag"):
            read_segmentation(jpeg(picture), options)


INVALID = {
    "no image": (b"no image", ImageError, "expected a PNG or JPEG"),
    "16 bits": (png(STREET.astype(np.uint16)), SegmentationError, "found 16"),
    "truncated": (png(painted(STREET))[:-20], ImageError, "ends too early"),
    "bits": (DAMAGED, ImageError, "cannot be decoded: it is damaged"),
}


@pytest.mark.parametrize(("content", "error", "message"), INVALID.values(), ids=INVALID)
def test_invalid_segmentation_file_is_refused(content, error, message):
    with pytest.raises(error, match=message):
        read_segmentation(content)


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"expected_wh": (5, 8)}, ImageSizeMismatch, "is 8 x 5 pixels, the image is 5"),
        ({"max_side": 7}, ImageTooLarge, "no side may exceed 7"),
        ({"options": NO_PALETTE}, UnknownFamily, r"found 'carla-0\.9\.15'"),
    ],
)
def test_another_size_or_palette_than_there_may_be_is_refused(options, error, message):
    with pytest.raises(error, match=message):
        read_segmentation(png(painted(STREET)), **options)


class TestTags:
    def test_tags_can_be_given_as_an_array(self):
        segmentation = segmentation_from_tags(STREET, FAMILY)

        assert (segmentation.wh, segmentation.encoding) == ((8, 5), "raw")
        np.testing.assert_array_equal(segmentation.tags, STREET)
        lacking = segmentation_from_tags(np.full((2, 2), 23, np.uint8), "carla-0.9.10")
        assert (lacking.tags == 255).all()
        assert lacking.unknown_pixels == 4

    @pytest.mark.parametrize(
        "tags",
        [
            np.zeros((2, 2), np.int64),
            np.zeros((2, 2, 3), np.uint8),
            np.zeros((0, 2), np.uint8),
        ],
        ids=["another dtype", "colours", "nothing"],
    )
    def test_array_that_is_not_a_tag_image_is_refused(self, tags):
        with pytest.raises(FilterError, match=r"expected an array \(H, W\) of uint8"):
            segmentation_from_tags(tags, FAMILY)


OF_CHANGED_CARLA = {"40": "Pedestrian", "100": "Car", "101": "Truck"}


def changed_street(of_carla: str = "carla-0.9.10") -> np.ndarray:
    """Raw tags of a street with people and cars that a changed CARLA numbers itself."""
    tag_of = FAMILIES[of_carla].tag_of
    tags = np.full((20, 30), tag_of("Road"), np.uint8)
    tags[:8] = tag_of("Building")
    tags[2:12, 3:8] = 40
    tags[10:18, 10:20] = 100
    tags[9:11, 12:14] = 101
    return tags


@pytest.mark.parametrize("form", ["grey", "red", "blue"])
def test_tags_of_a_changed_carla_are_read_and_all_others_are_the_palettes(form):
    numbers = changed_street()
    rgb = np.zeros((*numbers.shape, 3), np.uint8)
    rgb[..., 0 if form == "red" else 2] = numbers
    options = SegmentationOptions(palette="carla-0.9.10", tags=OF_CHANGED_CARLA)

    segmentation = read_segmentation(png(numbers if form == "grey" else rgb), options)

    # The palette has no Car, so all tags have the numbers of the family that has one.
    tag_of = FAMILIES["carla-0.9.14"].tag_of
    assert (segmentation.family, segmentation.unknown_pixels) == ("carla-0.9.14", 0)
    for number, name in [(40, "Pedestrian"), (100, "Car"), (101, "Truck")]:
        assert ((segmentation.tags == tag_of(name)) == (numbers == number)).all()
    for name in ("Road", "Building"):
        own = FAMILIES["carla-0.9.10"].tag_of(name)
        assert ((segmentation.tags == tag_of(name)) == (numbers == own)).all()


def test_tag_of_the_palette_that_has_no_name_beside_changed_ones_is_unknown():
    numbers = changed_street()
    numbers[:2] = FAMILIES["carla-0.9.10"].tag_of("Vehicle")
    options = SegmentationOptions(palette="carla-0.9.10", tags=OF_CHANGED_CARLA)

    segmentation = read_segmentation(png(numbers), options)

    assert segmentation.unknown_pixels == 60
    assert (segmentation.tags[:2] == 255).all()
    tags = {"40": "Pedestrian", "100": "Vehicle", "101": "Vehicle"}
    options = SegmentationOptions(palette="carla-0.9.10", tags=tags)

    reading = read_segmentation(png(changed_street()), options)

    assert reading.family == "carla-0.9.10"
    assert (reading.tags == 10).sum() == np.isin(changed_street(), (100, 101)).sum()


def test_changed_tags_prove_no_family_and_must_have_a_common_one():
    numbers = changed_street()
    numbers[numbers == 100] = 25
    options = SegmentationOptions(tags={"25": "Car", "40": "Walker", "101": "Truck"})

    with pytest.raises(SegmentationError, match="do not tell their family"):
        read_segmentation(png(numbers), options)
    options = SegmentationOptions(
        palette="carla-0.9.10", tags={"40": "Vehicle", "100": "Car", "101": "Truck"}
    )

    with pytest.raises(FilterError, match=r"found Car, .* and Vehicle, which is none"):
        read_segmentation(png(changed_street()), options)


@pytest.mark.parametrize("order", ["rgb", "bgr"])
def test_colours_of_a_changed_carla_are_read_beside_those_of_the_palette(order):
    rgb = painted(STREET)
    pink = (STREET == 14) & (np.arange(8) > 3)
    rgb[pink] = (250, 0, 130)
    rgb[STREET == 12] = FAMILIES[FAMILY].tags[5].rgb  # Fence
    tags = {"#fa0082": "Bus", "#be9999": "Pedestrian"}
    options = SegmentationOptions(tags=tags)

    segmentation = read_segmentation(png(rgb, order), options)

    assert (segmentation.family, segmentation.channel_order) == (FAMILY, order)
    assert segmentation.unknown_pixels == 0
    expected = STREET.copy()
    expected[pink] = 16
    assert (segmentation.tags == expected).all()
    # Boxes are counted in the colours, and not in `tags`.
    counted = measure(
        segmentation, frame_boxes([[0, 0, 8, 5]], (8, 5), "bus", {"bus": 1 << 16})
    )
    assert counted.matched_pixels.tolist() == [pink.sum()]
    with pytest.raises(SegmentationError, match=r"no known family.*250, 0, 130"):
        read_segmentation(png(rgb), SegmentationOptions())


def test_changed_colours_are_found_near_in_a_lossy_image():
    rgb = painted(LARGE_STREET)
    rgb[LARGE_STREET == 14] = (250, 0, 130)
    options = SegmentationOptions(lossy="nearest", tags={"#fa0082": "Bus"})

    segmentation = read_segmentation(jpeg(rgb), options)

    inside = np.kron(STREET == 14, np.ones((16, 16), bool))
    assert (segmentation.tags[inside] == 16).mean() > 0.9


@pytest.mark.parametrize("form", ["grey", "three channels"])
def test_grey_multiples_are_divided(form):
    street = changed_street("carla-0.9.14")
    tags = np.where(street < 40, street, np.where(street == 40, 12, 0))
    grey = (tags * 21).astype(np.uint8)
    picture = grey if form == "grey" else np.dstack([grey, grey, grey])
    named = SegmentationOptions(palette=FAMILY, tag_scale=21)

    segmentation = read_segmentation(png(picture), named)

    assert (segmentation.encoding, segmentation.unknown_pixels) == ("raw", 0)
    assert (segmentation.tags == tags).all()
    more = read_segmentation(
        png(picture),
        SegmentationOptions(palette=FAMILY, tag_scale=21, tags={"1": "Bus"}),
    )
    assert ((more.tags == 16) == (tags == 1)).all()
    with pytest.raises(SegmentationError, match=r"multiples of 20, found other"):
        read_segmentation(
            png(picture), SegmentationOptions(palette=FAMILY, tag_scale=20)
        )


def test_error_about_multiples_names_the_number_that_divides_them():
    grey = (np.arange(12, dtype=np.uint8) * 21).reshape(1, 12).repeat(4, 0)

    with pytest.raises(SegmentationError, match="tag_scale: 21 reads 231 as 11"):
        read_segmentation(png(grey), SegmentationOptions(palette=FAMILY))
    with pytest.raises(SegmentationError, match="by the key tags"):
        read_segmentation(
            png(changed_street()), SegmentationOptions(palette="carla-0.9.10")
        )
