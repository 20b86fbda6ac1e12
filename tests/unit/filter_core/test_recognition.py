"""What the images of a whole recording show about how they are read."""

import numpy as np
import pytest

from filter_core.config.filter import FilterConfig
from filter_core.errors import LayoutError
from filter_core.formats.reading import FrameSet, FrameSource
from filter_core.local import filter_source
from filter_core.recognition import Shown, recognise_recording
from filter_core.segmentation.palettes import FAMILIES
from tests.support.pictures import painted, pixels_of, png
from tests.support.sensors import depth_png, street_metres


def test_depth_images_of_a_recording_have_one_encoding(tmp_path):
    street, wall = street_metres(), np.full((48, 64), 5.0)
    swapped = {"a.png": street, "b.png": wall, "c.png": street}
    for name, metres in swapped.items():
        content = png(pixels_of(depth_png(metres))[..., ::-1], "bgr")
        (tmp_path / name).write_bytes(content)
    (tmp_path / "raw.png").write_bytes(depth_png(street))
    (tmp_path / "text.png").write_bytes(b"no image")

    def shown(*names, channels=("depth",), config=None):
        config = config or FilterConfig(evidence="depth")
        frames = [
            FrameSource(name, {}, others={"depth": tmp_path / name}) for name in names
        ]
        keys = recognise_recording(frames, config, channels).keys
        return keys.get("depth_encoding", config.depth_encoding)

    assert shown(*swapped, "text.png") == "carla-bgr"
    assert shown("raw.png", "b.png") == "carla"
    assert shown("a.png", "raw.png") == "auto"
    assert shown("b.png") == "auto"
    assert shown("a.png", channels=("instance",)) == "auto"
    named = FilterConfig(evidence="depth", depth_encoding="carla")
    assert shown("a.png", config=named) == "carla"


BUS = [{"id": "bus", "class": "bus", "xyxy": [10, 10, 50, 40]}]


def tagged_frame(folder, key, family, *tags, raw=False, version=None, order="rgb"):
    """A frame with a road, a vehicle in the middle, and stripes of other tags."""
    palette = FAMILIES[family]
    numbers = np.full((60, 80), palette.tag_of("Road"), np.uint8)
    numbers[10:40, 10:50] = palette.tag_of("Bus" if "Bus" in tags else CAR_OF[family])
    for row, tag in enumerate(tags):
        numbers[row] = palette.tag_of(tag)
    content = numbers if raw else painted(numbers, family)
    (folder / f"{key}.png").write_bytes(png(content, order))
    annotation = {"boxes": BUS} | ({"carla_version": version} if version else {})
    return FrameSource(key, annotation, segmentation=folder / f"{key}.png")


CAR_OF = {"carla-0.9.14": "Car", "paper-table1": "Car and Truck"}
CAR_OF |= dict.fromkeys(("carla-0.9.0", "carla-0.9.10"), "Vehicle")


def outcomes_of(shown, frames):
    """The outcomes of frames of a recording that shows this."""
    frame_set = FrameSet("manifest", lambda: iter(frames))
    return list(filter_source(shown.of(frame_set), FilterConfig()))


def palettes_of(shown, frames):
    return [outcome.palette for outcome in outcomes_of(shown, frames)]


def test_one_family_of_tags_is_told_by_all_images_of_a_recording(tmp_path):
    frames = [
        tagged_frame(tmp_path, "a", "carla-0.9.10"),
        tagged_frame(tmp_path, "b", "carla-0.9.10", "Terrain"),
        tagged_frame(tmp_path, "c", "carla-0.9.10", "Sky"),
    ]
    config = FilterConfig()
    alone = {outcome.key: outcome.error for outcome in filter_source(frames, config)}
    assert alone["a"]
    assert alone["a"]["code"] == "ambiguous_palette"

    shown = recognise_recording(frames, config)
    outcomes = outcomes_of(shown, frames)

    assert shown.keys == {"palette": "carla-0.9.10"}
    assert shown.notes == (
        "tags of carla-0.9.10: told by 1 of the 3 segmentations that were looked at",
    )
    assert [outcome.palette for outcome in outcomes] == ["carla-0.9.10"] * 3
    decisions = [outcome.decisions[0] for outcome in outcomes if outcome.decisions]
    assert [box["verdict"] for box in decisions] == ["kept"] * 3
    # The user's configuration stays the one that the decisions name.
    assert {box["config"] for box in decisions} == {config.digest}


def test_family_that_raw_tags_of_one_frame_prove_is_that_of_all(tmp_path):
    frames = [
        tagged_frame(tmp_path, "a", "carla-0.9.14", "Bus", raw=True),
        tagged_frame(tmp_path, "b", "carla-0.9.14", "Bus", "RoadLine", raw=True),
    ]

    shown = recognise_recording(frames, FilterConfig())

    assert shown.keys == {"palette": "carla-0.9.14"}
    assert [
        bool(outcome.error) for outcome in filter_source(frames, FilterConfig())
    ] == [1, 0]
    assert palettes_of(shown, frames) == ["carla-0.9.14"] * 2


def test_images_that_prove_several_families_are_an_error_that_names_two(tmp_path):
    old, new = "carla-0.9.10", "carla-0.9.14"
    frames = [
        tagged_frame(tmp_path, "first", new, "Terrain"),
        tagged_frame(tmp_path, "none", new),
        tagged_frame(tmp_path, "last", old, "Terrain"),
    ]

    with pytest.raises(LayoutError) as refused:
        recognise_recording(frames, FilterConfig())

    assert refused.value.kind == "several_families"
    assert f"first is of {new}, last is of {old}" in str(refused.value)
    # Who names the palette, or the version of a frame, is not asked.
    assert recognise_recording(frames, FilterConfig(palette=new)).keys == {}
    frames[2] = tagged_frame(tmp_path, "last", old, "Terrain", version="0.9.12")
    shown = recognise_recording(frames, FilterConfig())
    assert palettes_of(shown, frames) == [new, new, old]


def test_frame_that_contradicts_the_other_images_is_refused_and_says_so(tmp_path):
    frames = [tagged_frame(tmp_path, "a", "carla-0.9.14", "Terrain")]
    late = tagged_frame(tmp_path, "z", "carla-0.9.10", "Terrain")

    (outcome,) = outcomes_of(recognise_recording(frames, FilterConfig()), [late])

    assert outcome.error
    assert outcome.error["detail"].startswith(
        "the recording says palette carla-0.9.14, the colours that occur prove "
        "carla-0.9.10"
    )


def test_table_of_the_paper_is_told_only_if_no_version_of_carla_is(tmp_path):
    paper = tagged_frame(tmp_path, "a", "paper-table1", "Fence", "Bus")
    carla = tagged_frame(tmp_path, "b", "carla-0.9.14", "Terrain")

    for frames, family in (([paper], "paper-table1"), ([paper, carla], "carla-0.9.14")):
        shown = recognise_recording(frames, FilterConfig())
        assert shown.keys == {"palette": family}


def test_what_one_image_tells_holds_for_all_and_what_none_tells_for_none(tmp_path):
    frames = [
        tagged_frame(tmp_path, tag, "carla-0.9.14", tag, order="bgr")
        for tag in ("Terrain", "Sky")
    ]

    shown = recognise_recording(frames, FilterConfig())

    assert shown.keys == {"palette": "carla-0.9.14", "channel_order": "bgr"}
    frames = [tagged_frame(tmp_path, key, "carla-0.9.14") for key in "abc"]

    assert recognise_recording(frames, FilterConfig()) == Shown()
    assert recognise_recording([FrameSource("a", {})], FilterConfig()) == Shown()


def test_few_images_of_many_are_looked_at_unless_they_tell_nothing(tmp_path):
    plain = tagged_frame(tmp_path, "a", "carla-0.9.14")
    telling = tagged_frame(tmp_path, "b", "carla-0.9.14", "Terrain")

    def looked_at(frames):
        (note,) = recognise_recording(frames, FilterConfig()).notes
        return note.partition("told by ")[2].partition(" segm")[0]

    assert looked_at([telling] * 200) == "5 of the 5"
    # The seventh of twelve that are spread over nine frames, of which three are first.
    assert looked_at([plain, plain, telling, *[plain] * 6]) == "1 of the 5"
