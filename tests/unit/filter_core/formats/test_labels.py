"""A recording in another unit or notation is refused as a whole, until that is said."""

import json

import numpy as np
import pytest

from filter_core.annotation.parsing import parse_annotation
from filter_core.config.file import load_config
from filter_core.errors import LayoutError
from filter_core.formats.reading import RECORDING_NAME
from filter_core.formats.recording import describe
from filter_core.formats.registry import read_source
from filter_core.geometry.boxes import to_xyxy
from tests.support.folders import write_files
from tests.support.pictures import png

WIDTH, HEIGHT = 640, 360
BOXES = [
    [186.5, 180.0, 260.0, 223.0],
    [12.0, 31.25, 50.0, 66.0],
    [400.0, 210.0, 637.0, 301.0],
]
FRAMES = 2


def shares(box):
    sides = (WIDTH, HEIGHT, WIDTH, HEIGHT)
    return [number / side for number, side in zip(box, sides, strict=True)]


def percent(box):
    return [100 * share for share in shares(box)]


def sized(box):
    return [box[0], box[1], box[2] - box[0], box[3] - box[1]]


def centred(box):
    x, y, width, height = sized(box)
    return [x + width / 2, y + height / 2, width, height]


def yolo(boxes):
    lines = [f"0 {' '.join(map(str, box))}\n" for box in boxes]
    return {f"labels/{n}.txt": "".join(lines) for n in range(FRAMES)} | {
        "classes.txt": "car\n"
    }


def coco(boxes):
    images = [
        {"id": n, "file_name": f"{n}.png", "width": WIDTH, "height": HEIGHT}
        for n in range(FRAMES)
    ]
    annotations = [
        {"id": n * 100 + i, "image_id": n, "category_id": 1, "bbox": box}
        for n in range(FRAMES)
        for i, box in enumerate(boxes)
    ]
    names = [{"id": 1, "name": "car"}]
    document = {"images": images, "annotations": annotations, "categories": names}
    return {"annotations.json": json.dumps(document)}


def voc(boxes):
    names = ("xmin", "ymin", "xmax", "ymax")
    text = "<annotation>"
    for box in boxes:
        edges = [f"<{key}>{at}</{key}>" for key, at in zip(names, box, strict=True)]
        rectangle = f"<bndbox>{''.join(edges)}</bndbox>"
        text += f"<object><name>car</name>{rectangle}</object>"
    text += "</annotation>"
    return {f"Annotations/{n}.xml": text for n in range(FRAMES)}


def kitti(boxes):
    rest = "-1 -1 -1 -1000 -1000 -1000 0"
    lines = [f"Car 0 0 0 {' '.join(map(str, box))} {rest}\n" for box in boxes]
    return {f"label_2/{n}.txt": "".join(lines) for n in range(FRAMES)}


def manifest(form):
    def lines(boxes):
        rows = [{"class": "car", form: box} for box in boxes]
        frames = [
            {"key": f"{n}", "image": f"images/{n}.png", "boxes": rows}
            for n in range(FRAMES)
        ]
        return {"manifest.jsonl": "\n".join(map(json.dumps, frames))}

    return lines


IMAGE_FOLDERS = {voc: "JPEGImages", kitti: "image_2"}


def recording(folder, write, boxes, description=""):
    """A recording whose frames all have the same boxes, and perhaps a description."""
    images = IMAGE_FOLDERS.get(write, "images")
    picture = png(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
    files = {f"{images}/{n}.png": picture for n in range(FRAMES)}
    if description:
        files[RECORDING_NAME] = description
    return write_files(folder, files | write(boxes))


def boxes_of(source):
    """The boxes of each frame."""
    return [parse_annotation(frame.annotation or {}).boxes for frame in source]


def rectangles(source):
    """The rectangles of all frames in pixels."""
    return [
        [to_xyxy(box.form, [box.values], (WIDTH, HEIGHT))[0] for box in boxes]
        for boxes in boxes_of(source)
    ]


@pytest.mark.parametrize(
    ("write", "convert", "said", "missing"),
    [
        (yolo, lambda box: percent(centred(box)), "", "unit: percent"),
        (yolo, centred, "", "unit: pixels"),
        (yolo, shares, "", "corners: xyxy"),
        (coco, lambda box: percent(sized(box)), "", "unit: percent"),
        (coco, lambda box: shares(sized(box)), "", "unit: shares"),
        (coco, list, "", "corners: xyxy"),
        (voc, percent, "", "unit: percent"),
        (voc, shares, "", "unit: shares"),
        (voc, sized, "", "corners: xywh"),
        (kitti, percent, "", "unit: percent"),
        (kitti, shares, "", "unit: shares"),
        (kitti, sized, "", "corners: xywh"),
        (manifest("xyxy"), percent, "", "unit: percent"),
        (manifest("xyxyn"), list, "", "unit: pixels"),
        (manifest("xyxy"), sized, "", "corners: xywh"),
        (manifest("cxcywh"), list, "", "corners: xyxy"),
        (yolo, list, "unit: pixels, ", "corners: xyxy"),
        (yolo, percent, "unit: percent, ", "corners: xyxy"),
        (coco, percent, "unit: percent, ", "corners: xyxy"),
    ],
)
def test_recording_in_another_unit_or_notation_is_read_as_its_description_says(
    tmp_path, write, convert, said, missing
):
    boxes = [convert(box) for box in BOXES]

    with pytest.raises(LayoutError) as caught:
        read_source(recording(tmp_path, write, boxes, said and f"boxes: {{{said}}}"))
    described = recording(tmp_path, write, boxes, f"boxes: {{{said}{missing}}}")

    assert caught.value.kind == f"wrong_{missing.partition(':')[0]}"
    assert f"`boxes: {{{missing}}}`" in caught.value.detail
    for xyxy in rectangles(read_source(described)):
        np.testing.assert_allclose(xyxy, BOXES, atol=1e-9)


STARTS = np.linspace(1, 80, 12).tolist()
MANY = [[x, 0.5 * x, x + 9.5, 0.5 * x + 20] for x in STARTS]
FEW = [[3.5, 4, 40, 50], [60, 12.5, 98, 31], [1, 1, 9, 9.5]]


@pytest.mark.parametrize(
    ("boxes", "size", "is_refused"),
    [
        (MANY, (180, 320), True),
        (MANY[::2], (180, 320), False),
        (FEW, (100, 100), False),
    ],
)
def test_many_boxes_show_percent_in_smaller_pictures(tmp_path, boxes, size, is_refused):
    picture = png(np.zeros((*size, 3), np.uint8))
    pictures = {f"images/{n}.png": picture for n in range(FRAMES)}
    folder = write_files(tmp_path, pictures | manifest("xyxy")(boxes))

    if not is_refused:
        assert len(list(read_source(folder))) == FRAMES
        return
    with pytest.raises(LayoutError, match="percent"):
        read_source(folder)


def test_share_that_is_the_corner_and_the_size_is_read(tmp_path):
    boxes = [shares(sized(box)) for box in BOXES]
    source = recording(tmp_path, yolo, boxes, "boxes: {corners: xywh}")

    for xyxy in rectangles(read_source(source)):
        np.testing.assert_allclose(xyxy, BOXES, atol=1e-9)


@pytest.mark.parametrize(
    ("write", "boxes"),
    [
        (manifest("xyxy"), [[3.5, 4, 40, 50], [60, 12.5, 99, 31]]),  # too few
        (manifest("xyxy"), [[n, n, 90, 99] for n in range(1, 7)]),  # whole numbers
        (manifest("xyxy"), [[3.5, 4, 40, 50], [60, 2.5, 99, 31], [1, 1, 101, 9]]),
        (manifest("xyxy"), [[640, 180, 630, 223], [0, 0, 9, 9], [1, 1, 9, 9]]),
        (manifest("xyxyn"), [[0.1, 0.1, 0.5, 0.5], [-8, 0, 9, 1], [0, 0, 12, 1]]),
        (coco, [[0, 0, 640, 360], [10, 20, 600, 330], [5, 5, 630, 350]]),  # close-ups
        (coco, [[-90, -70, 320, 260], [-5, 0, 500, 200], [0, 0, 9, 90]]),
        (yolo, [[0.5, 0.5, 0.99, 0.98], [0.3, 0.4, 0.6, 0.7], [0.2, 0.2, 0.4, 0.4]]),
    ],
)
def test_boxes_that_may_be_meant_are_not_refused(tmp_path, write, boxes):
    source = read_source(recording(tmp_path, write, boxes))

    assert [len(each) for each in boxes_of(source)] == [len(boxes)] * FRAMES


def test_class_of_another_name_is_joined_to_it(tmp_path):
    classes = {"classes.txt": "street_light\ncar\ntraffic_light\n"}
    lines = {"labels/0.txt": "0 .5 .5 .1 .1\n2 .3 .3 .1 .1\n1 .2 .2 .1 .1\n"}
    text = (
        "classes: {street_light: {name: traffic_light}, car: {min_visible_pixels: 3}}"
    )
    folder = write_files(tmp_path, {**classes, **lines, RECORDING_NAME: text})

    source = read_source(folder)
    (boxes,) = boxes_of(source)

    names = [box.class_name for box in boxes]
    assert names == ["traffic_light", "traffic_light", "car"]
    assert source.classes == ("traffic_light", "car")
    loaded = load_config(b"", below=describe(folder).config_keys())
    assert set(loaded.config.classes) == {"car"}


@pytest.mark.parametrize(
    ("description", "files", "maps"),
    [
        ("", ["Town03/1.png", "a/Town10HD_Opt_rain/2.png", "x_town05_3.png", "4.png"],
         [None, "Town03", "Town10HD_Opt", "Town05"]),
        ("", ["Mine_01/1.png", "downtown01/2.png", "Town011/3.png"],
         ["Mine_01", None, None]),
        ("map: none", ["Town03/1.png"], [None]),
        ("map: Isle of Dogs", ["Town03/1.png"], ["Isle of Dogs"]),
        ("files: {image: '{map}/{frame}.png'}", ["north/1.png", "2.png"],
         [None, "north"]),
        ("files: {image: '{map}_{frame}.png', labels: '{map}/{frame}.json'}",
         ["north_1.png"], ["north"]),
    ],
)  # fmt: skip
def test_map_is_told_by_names_or_said_by_the_description(
    tmp_path, description, files, maps
):
    write_files(tmp_path, {RECORDING_NAME: description, **dict.fromkeys(files)})
    write_files(tmp_path, {"north/1.json": '{"boxes": []}'})

    recording = read_source(tmp_path)

    assert [(frame.annotation or {}).get("map") for frame in recording] == maps
    told = [note for note in recording.notes() if note.startswith("maps of frames")]
    assert len(told) == (any(maps) and not description)


def test_map_of_labels_wins_over_that_of_names(tmp_path):
    rows = "image,town,class,x1,y1,x2,y2\nTown01/1.png,Town07,car,1,2,3,4\n"
    write_files(tmp_path, {"Town01/1.png": None, "Town02/2.png": None, "b.csv": rows})

    frames = list(read_source(tmp_path))

    assert [(frame.annotation or {})["map"] for frame in frames] == ["Town07", "Town02"]
