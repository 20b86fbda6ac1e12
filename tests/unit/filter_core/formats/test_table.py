"""The layout `table`: boxes as rows of CSV, TSV, JSON, JSON Lines or NPZ."""

import gzip
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import LayoutError
from filter_core.formats.reading import RECORDING_NAME
from filter_core.formats.registry import read_source
from tests.support.folders import annotation_of, write_files

KEYS = ("frame", "id", "label", "xmin", "ymin", "xmax", "ymax")
ROWS = [
    dict(zip(KEYS, ("7", 3, "car", 1.5, 2, 3, 4), strict=True)),
    dict(zip(KEYS, ("8", 4, "bus", 5, 6, 7, 8), strict=True)),
]
BOXES = {
    "7": [{"id": 3, "class": "car", "xyxy": [1.5, 2, 3, 4]}],
    "8": [{"id": 4, "class": "bus", "xyxy": [5, 6, 7, 8]}],
}
IMAGES = dict.fromkeys(("rgb/0007.png", "rgb/0008.png", "rgb/0009.png"))


def delimited(rows, delimiter=","):
    lines = [delimiter.join(rows[0])]
    lines += [delimiter.join(str(cell) for cell in row.values()) for row in rows]
    return "\n".join(lines) + "\n"


def lines(rows):
    return "".join(f"{json.dumps(row)}\n" for row in rows)


def npz(**arrays):
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def packed(text):
    return gzip.compress(text.encode())


def columns(rows):
    return {key: np.array([row[key] for row in rows]) for key in rows[0]}


def read(folder, files, description=""):
    """The frames, after `files` and a description were written into the folder."""
    write_files(folder, {**files, RECORDING_NAME: description})
    return read_source(folder)


def boxes_of(frames):
    return {
        frame.key.rpartition("/")[2]: annotation_of(frame)["boxes"] for frame in frames
    }


def ids_as_text(boxes):
    return [{**box, "id": str(box["id"])} for box in boxes]


def without(rows, key):
    return [{name: value for name, value in row.items() if name != key} for row in rows]


BY_FRAME = [
    {"frame": int(str(row["frame"])), "boxes": without([row], "frame")} for row in ROWS
]
MANY = {
    "boxes.csv": delimited(ROWS),
    "semicolons/boxes.csv": delimited(ROWS, ";"),
    "boxes.tsv": delimited(ROWS, "\t"),
    "boxes.csv.gz": packed(delimited(ROWS)),
    "boxes.json": json.dumps(ROWS),
    "by frame/boxes.json": json.dumps({row["frame"]: [row] for row in ROWS}),
    "frames/boxes.json": json.dumps(BY_FRAME),
    "boxes.json.gz": packed(json.dumps(ROWS)),
    "boxes.jsonl.gz": packed(lines(ROWS)),
    "boxes.npz": npz(**columns(ROWS)),
}


@pytest.mark.parametrize("name", MANY)
def test_one_file_holds_the_boxes_of_many_frames(tmp_path, name):
    """Columns have their usual names; the frame may be a number without zeros."""
    frames = read(tmp_path, {**IMAGES, f"labels/{name}": MANY[name]})

    assert (frames.layout, frames.count, frames.unmatched) == ("table", 3, ())
    boxes = {key: ids_as_text(boxes) for key, boxes in boxes_of(frames).items()}
    cars, buses = (ids_as_text(boxes) for boxes in BOXES.values())
    assert boxes == {"0007": cars, "0008": buses, "0009": []}


ONE = without(ROWS[:1], "frame")
OF_A_FRAME = {
    "0007.csv": delimited(ONE),
    "0007.tsv": delimited(ONE, "\t"),
    "0007.csv.gz": packed(delimited(ONE)),
    "0007.json": json.dumps(ONE),
    "0007.json.gz": packed(json.dumps({"objects": ONE})),
    "0007.jsonl": lines(ONE),
    "0007.jsonl.gz": packed(lines(ONE)),
    "0007.npz": npz(**columns(ONE)),
}


@pytest.mark.parametrize("name", OF_A_FRAME)
def test_a_file_holds_the_boxes_of_one_frame(tmp_path, name):
    files = {**IMAGES, f"boxes/{name}": OF_A_FRAME[name]}
    frames = read(tmp_path, files, "layout: table")
    (boxes,) = boxes_of(frames).values()
    assert ids_as_text(boxes) == ids_as_text(BOXES["7"])
    assert [file.path for file in frames.unmatched] == ["rgb/0008.png", "rgb/0009.png"]


@pytest.mark.parametrize(
    ("row", "fields", "box"),
    [
        ({"x": 1, "y": 2, "w": 3, "h": 4, "type": "car"}, "{}",
         {"class": "car", "xywh": [1, 2, 3, 4]}),
        ({"x_center": "1", "y_center": " 2 ", "width": "3.5", "height": "4e0",
          "name": "car"}, "{}", {"class": "car", "cxcywh": [1, 2, 3.5, 4]}),
        ({"bbox": {"x_min": 1, "y_min": 2, "x_max": 3, "y_max": 4}, "bp_id": "v.x"},
         "{}", {"type_id": "v.x", "xyxy": [1, 2, 3, 4]}),
        ({"bbox": [[1, 2], [3, 4]]}, "{}", {"class": "unknown", "xyxy": [1, 2, 3, 4]}),
        ({"xyxy": "[1, 2, 3, 4]", "instance_id": "12", "distance": "7.5"}, "{}",
         {"instance_id": 12, "distance": 7.5, "class": "unknown",
          "xyxy": [1, 2, 3, 4]}),
        ({"a b": 1, "y": [2, 3], "c": 4, "what": {"is": "car"}, "n": 5},
         "{x1: a b, y1: 'y[0]', x2: 'y[1]', y2: c, class: what.is, id: n}",
         {"id": 5, "class": "car", "xyxy": [1, 2, 3, 4]}),
        ({"at": [1, 2, 3], "half": [4, 5, 6], "yaw": "90", "car": "van"},
         "{centre: at, extent: half, rotation: '{yaw: yaw}', class: car}",
         {"class": "van", "box3d": {"location": {"x": 1, "y": 2, "z": 3},
                                    "extent": {"x": 4, "y": 5, "z": 6},
                                    "rotation": {"pitch": 0, "yaw": 90, "roll": 0}}}),
        ({"location": {"x": 1, "y": 0, "z": 1}, "extent": {"x": 4, "y": 5, "z": 6},
          "actor_transform": {"Location": {"x": 7, "y": 8, "z": 9},
                              "Rotation": {"yaw": 90}}}, "{}",
         {"class": "unknown",
          "box3d": {"location": {"x": 1, "y": 0, "z": 1},
                    "extent": {"x": 4, "y": 5, "z": 6},
                    "transform": {"x": 7, "y": 8, "z": 9,
                                  "pitch": 0, "yaw": 90, "roll": 0}}}),
        ({"verts": [[i, i, i] for i in range(8)]}, "{world_corners: verts}",
         {"class": "unknown", "vertices": [[i, i, i] for i in range(8)]}),
    ],
)  # fmt: skip
def test_row_is_read_by_usual_names_or_by_what_is_said(tmp_path, row, fields, box):
    description = f"layout: table\nboxes: {{fields: {fields}}}"

    (frame,) = read(tmp_path, {"1.png": None, "1.json": json.dumps([row])}, description)

    assert annotation_of(frame)["boxes"] == [box]


def test_projected_corners_become_the_rectangle_of_what_is_in_front(tmp_path):
    """A box that reaches behind the camera is cut there, and one behind it left out."""

    def corners(depths):
        """A box 2 m wide and high, of a camera with a focal length of 10 px."""
        points = [(x, y, z) for z in depths for y in (-1, 1) for x in (-1, 1)]
        return [[10 * x / z, 10 * y / z, z] for x, y, z in points]

    boxes = [corners((2, 4)), corners((-4, -2)), corners((-1, 1))]
    description = "boxes: {fields: {boxes: {van: arr_0}, image_corners: '@'}}"
    files = {"1.png": None, "1.npz": npz(arr_0=np.array(boxes))}

    frames = read(tmp_path, files, description)
    (frame,) = frames

    assert annotation_of(frame)["boxes"] == [
        {"class": "van", "xyxy": [-5, -5, 5, 5]},
        {"class": "van", "xyxy": pytest.approx([-100, -100, 100, 100])},
    ]
    (note,) = frames.notes()
    assert note.startswith("1 rows have no rectangle, or that of a box behind the")


def test_unit_corners_and_classes_of_a_description_hold_for_tables_too(tmp_path):
    text = "frame,cls,a,b,c,d\n1,40,10,20,30,40\n1,100,50,50,10,10\n1,7,50,50,1,1\n"
    description = """
    boxes:
      unit: percent
      corners: cxcywh
      classes: {40: walker, 100: car}
      fields: {class: cls, rectangle: "[a, b, c, d]"}
    """

    (frame,) = read(tmp_path, {"1.png": None, "all.csv": text}, description)

    first, second, third = annotation_of(frame)["boxes"]
    assert [first["class"], second["class"], third["class"]] == ["walker", "car", "7"]
    assert first["cxcywhn"] == pytest.approx([0.1, 0.2, 0.3, 0.4])


def test_columns_without_names_are_numbered(tmp_path):
    files = {"1.png": None, "1.txt": "car 1 2 3 4\nbus 5 6 7 8\n"}

    (frame,) = read(
        tmp_path,
        files,
        "layout: table\nfiles: {image: '{frame}.png', labels: '{frame}.txt'}\n"
        "boxes: {fields: {class: 0, x1: 1, y1: 2, x2: 3, y2: 4}}",
    )

    assert [box["class"] for box in annotation_of(frame)["boxes"]] == ["car", "bus"]


BAD_ROW = "frame,label,x1,y1,x2,y2\n7,car,1,2,3,4\n8,car,1,two,3,4\n7,bus,5,6,7,8\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (BAD_ROW, 'boxes.csv, row 3, column y1: expected a number, found "two"'),
        (BAD_ROW.replace("two", ""), "row 3, column y1: expected a number, found null"),
        (BAD_ROW.replace("two", "nan"), "row 3, column y1: expected a finite number"),
        (BAD_ROW.replace("two,3", "2,3,5"), "row 3: expected 6 columns, found 7"),
    ],
)
def test_bad_row_spoils_its_frame_and_not_the_file(tmp_path, text, words):
    first, second, third = read(tmp_path, {**IMAGES, "boxes.csv": text})

    assert [box["class"] for box in annotation_of(first)["boxes"]] == ["car", "bus"]
    assert words in str(second.problem)
    assert annotation_of(third)["boxes"] == []


@pytest.mark.parametrize("frame", ["7", "0007", "rgb_0007", "rgb_0007.png"])
def test_row_may_call_its_frame_by_the_number_of_the_picture(tmp_path, frame):
    text = f"frame,class,x1,y1,x2,y2\n{frame},car,1,2,3,4\n"
    images = {f"rgb_000{number}.png": None for number in (7, 8)}
    write_files(tmp_path, {"boxes.csv": text, **images})

    counts = {key: len(boxes) for key, boxes in boxes_of(read_source(tmp_path)).items()}

    assert counts == {"rgb_0007": 1, "rgb_0008": 0}


def test_rows_of_no_frame_are_listed_with_their_place(tmp_path):
    text = BAD_ROW.replace("8,", "12,") + ",car,1,2,3,4\n"

    frames = read(tmp_path, {**IMAGES, "boxes.csv": text})

    assert [(file.path, file.why) for file in frames.unmatched] == [
        ("boxes.csv", 'no image of frame "12" (1 rows, the first is boxes.csv, row 3)'),
        ("boxes.csv", "no frame (1 rows, the first is boxes.csv, row 5)"),
    ]
    assert len(boxes_of(frames)["0007"]) == 2


CAMERAS = "files: {image: '{camera}/{frame}.png', labels: boxes.csv}"
TWO = dict.fromkeys(("left/1.png", "right/1.png"))


def test_rows_name_their_camera_or_a_rectangle_of_several_is_refused(tmp_path):
    text = "frame,cam,x1,y1,x2,y2\n1,left,1,2,3,4\n1,RIGHT,5,6,7,8\n"

    left, right = read(tmp_path / "named", {**TWO, "boxes.csv": text}, CAMERAS)
    unnamed = text.replace("cam", "seen by")
    bad = next(iter(read(tmp_path / "other", {**TWO, "boxes.csv": unnamed}, CAMERAS)))

    assert [box["xyxy"] for box in annotation_of(left)["boxes"]] == [[1, 2, 3, 4]]
    assert [box["xyxy"] for box in annotation_of(right)["boxes"]] == [[5, 6, 7, 8]]
    assert "boxes.csv, row 2: expected a rectangle of one frame" in str(bad.problem)
    assert "camera" in str(bad.problem)


@pytest.mark.parametrize(
    ("files", "description", "words"),
    [
        ({"boxes.csv": "label,x1,y1,x2,y2\ncar,1,2,3,4\n"}, "",
         "boxes.csv, row 2: expected the name of a frame"),
        ({"boxes.csv": "image,x1,y1,x2,y2\n7,1,2,3,4\n"},
         "boxes: {fields: {frame: image, class: kind, id: actor}}",
         "found none called kind (class), actor (id), only image, x1, y1, x2, y2"),
        ({"boxes.csv": "frame,x1,x1\n1,2,3\n"}, "layout: table",
         "boxes.csv, row 1: expected each column once, found 'x1' again"),
        ({"boxes.npz": b"PK"}, "layout: table", "boxes.npz: expected arrays of NumPy"),
        ({"boxes.csv.gz": b"no"}, "layout: table", "boxes.csv.gz: expected gzip"),
        ({"boxes.npz": npz(a=np.array([{}]))}, "layout: table", "not a number"),
    ],
)  # fmt: skip
def test_file_of_many_frames_that_cannot_be_read_is_refused(
    tmp_path, files, description, words
):
    with pytest.raises(LayoutError) as caught:
        read(tmp_path, {**IMAGES, **files}, description)

    assert words in caught.value.detail


@pytest.mark.parametrize(
    ("content", "fields", "words"),
    [
        ({"a": 1}, "{}", "1.json: expected a list of boxes, found an object of a"),
        ([{"a": 1}], "{}", "1.json, box 0: expected a rectangle or a 3D box, found "
         "only a"),
        ([{"bbox": [1, 2, 3, 4]}], "{}", "column bbox: expected a rectangle whose "
         "notation is known"),
        ([{"a": 1}], "{xyxy: b}", "1.json, box 0: expected xyxy under b, found only a"),
        ({"boxes": {}}, "{boxes: boxes}", "1.json, boxes: expected a list of boxes"),
        ({"a": [1], "b": [1, 2]}, "{x1: a, y1: a, x2: b, y2: b}",
         "expected as many values of each field, found x1 1, y1 1, x2 2, y2 2"),
        ([{"xyxy": [1, 2, 3, 4], "label": 3}], "{}", "expected a class from 0 to 1"),
    ],
)  # fmt: skip
def test_fault_in_a_frames_labels_is_its_problem(tmp_path, content, fields, words):
    description = f"layout: table\nboxes: {{classes: [car, bus], fields: {fields}}}"
    files = {"1.png": None, "1.json": json.dumps(content)}

    (frame,) = read(tmp_path, files, description)

    assert words in str(frame.problem)


def test_ids_that_are_not_unique_are_no_ids_unless_they_are_said_to_be(tmp_path):
    rows = [{"id": 1, "xyxy": [1, 2, 3, 4]}, {"id": 1, "xyxy": [5, 6, 7, 8]}]
    files = {"1.png": None, "1.json": json.dumps(rows)}

    (usual,) = read(tmp_path / "usual", files, "layout: table")
    (said,) = read(tmp_path / "said", files, "boxes: {fields: {id: id}}")

    assert all("id" not in box for box in annotation_of(usual)["boxes"])
    assert all("id" in box for box in annotation_of(said)["boxes"])


POSES = "frame,x,y,z,yaw\n0001,10,0,0,90\n"
MOUNTS = [{"sensor": "left", "position": [0, 0, 2], "rotation": {"pitch": -10}}]


@pytest.mark.parametrize(
    ("cameras", "files"),
    [
        ("pose: poses.csv, mount: mounts.json",
         {"poses.csv": POSES, "mounts.json": json.dumps(MOUNTS)}),
        ("""pose: {file: "poses/{frame}.json"}, mount: {left: {z: 2, x: 0, y: 0,
         pitch: -10}}""", {"poses/1.json": '{"x": 10, "y": 0, "z": 0, "yaw": 90}'}),
        ("""pose: {file: all.json, path: 'ego."{frame}"'}, mount: {file: all.json,
         path: "cams[?name == '{camera}'] | [0]", negated: [pitch]}""",
         {"all.json": json.dumps(
             {"ego": {"1": {"Location": {"x": 10, "y": 0, "z": 0},
                            "Rotation": {"yaw": 90}}},
              "cams": [{"name": "left", "translation": [0, 0, 2],
                        "rotation": {"pitch": 10}}]})}),
        ("pose: world", {}),
    ],
)  # fmt: skip
def test_camera_of_3d_boxes_is_found_where_the_description_says(
    tmp_path, cameras, files
):
    """The camera is 2 m above a vehicle that looks along y, and tilted down."""
    world = {"x": 10, "y": 0, "z": 2, "yaw": 90, "pitch": -10}
    box = {"location": {"x": 10, "y": 20, "z": 2}, "extent": {"x": 1, "y": 1, "z": 1}}
    labels = {"objects": [{**box, "label": "car"}], "world": world}
    description = f"""
    files: {{image: "{{camera}}/{{frame}}.png", labels: "boxes/{{frame}}.json"}}
    cameras: {{fov: 90, {cameras}}}
    """
    images = {"left/1.png": None, "boxes/1.json": json.dumps(labels)}

    frames = read(tmp_path, {**images, **files}, description)
    (frame,) = frames

    annotation = parse_annotation(annotation_of(frame))
    assert (annotation.camera_wh, frame.key) == ((80, 60), "left/1")
    x_min, y_min, x_max, y_max = frame_boxes_2d(annotation, (80, 60)).xyxy[0]
    assert (x_min + x_max) / 2 == pytest.approx(40)
    below = 30 - 40 * np.tan(np.radians(10))
    assert (y_min + y_max) / 2 == pytest.approx(below, abs=0.1)
    assert frames.unmatched == ()


@pytest.mark.parametrize(
    ("cameras", "words"),
    [
        ("pose: nowhere.json", "nowhere.json: cannot be read"),
        ("pose: here", "cameras.pose: expected a value in the labels, at here"),
        ("mount: {right: {x: 1}}", "cameras.mount: expected a value of camera 'left'"),
        ("pose: poses.csv", "cameras.pose: poses.csv has nothing at frame 1"),
        ("pose: flat", "cameras.pose: expected a rigid motion"),
        ("mount: {x: a}", "cameras.mount: expected {x, y, z} or a list of 3 numbers"),
    ],
)
def test_camera_that_is_not_there_is_its_frames_problem(tmp_path, cameras, words):
    description = f"""
    files: {{image: "{{camera}}/{{frame}}.png", labels: "{{frame}}.json"}}
    cameras: {{{cameras}}}
    """
    labels = json.dumps({"boxes": [], "flat": [[0] * 4] * 4})
    files = {"left/1.png": None, "1.json": labels, "poses.csv": "frame,x\n2,3\n"}

    (frame,) = read(tmp_path, files, description)

    assert words in str(frame.problem)


DOCS = Path(__file__).parents[4] / "docs/formats.md"


def test_examples_of_the_documentation_are_read(tmp_path):
    section = DOCS.read_text("utf-8").split("### Tables of boxes")[1].split("\n### ")[0]
    text = dict(re.findall(r"```(\w+)\n(.*?)```", section, re.S))
    images = dict.fromkeys(("rgb/000001.png", "rgb/000002.png"))
    world = {"x": 0, "y": 0, "z": 0}
    row = {"what": {"kind": "car"}, "pos": [9, 0, 2], "half": [1, 1, 1], "heading": 5}
    recorded = {
        **dict.fromkeys(("CAM_left/1.jpg", "SEG_left/1.png", "a/preview/1.jpg")),
        "labels/1.json": json.dumps({"objects": [row]}),
        "ego.json": json.dumps({"1": world}),
        "rig.json": json.dumps([{"name": "left", "position": [0, 0, 2]}]),
    }

    of_csv = boxes_of(read(tmp_path / "csv", {**images, "boxes.csv": text["csv"]}))
    files = {**images, "boxes/000001.json": text["json"]}
    of_json = boxes_of(read(tmp_path / "json", files))
    (frame,) = read(tmp_path / "described", recorded, text["yaml"])

    assert [len(of_csv["000001"]), len(of_csv["000002"])] == [2, 1]
    assert of_json == {
        "000001": [{"id": 217, "class": "car", "xyxy": [100, 120, 180, 160.5]}]
    }
    annotation = parse_annotation(annotation_of(frame))
    assert (frame.key, annotation.boxes[0].class_name) == ("left/1", "car")
    x_min, y_min, x_max, y_max = frame_boxes_2d(annotation, (80, 60)).xyxy[0]
    assert (y_min + y_max) / 2 == pytest.approx(30)
    assert x_min < 40 < x_max


@pytest.mark.parametrize(
    "names",
    [
        ("x0", "y0", "x1", "y1"),
        ("x_min (px)", "y_min (px)", "x_max (px)", "y_max (px)"),
        ("tl_x", "tl_y", "br_x", "br_y"),
        ("u_min", "v_min", "u_max", "v_max"),
    ],
)
def test_table_is_recognised_by_columns_that_speak_for_themselves(tmp_path, names):
    columns = ("image", "id", "label", *names)
    rows = [dict(zip(columns, row.values(), strict=True)) for row in ROWS]
    files = {**IMAGES, "boxes.csv": delimited(without(rows, "id"))}

    frames = read_source(write_files(tmp_path, files))

    assert frames.layout == "table"
    boxes = [box for frame in frames for box in annotation_of(frame)["boxes"]]
    assert [box["xyxy"] for box in boxes] == [[1.5, 2, 3, 4], [5, 6, 7, 8]]
