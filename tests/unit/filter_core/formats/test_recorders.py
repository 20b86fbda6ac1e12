"""Recordings of public recorders are read without a description and without options."""

import gzip
import io
import itertools
import json
from collections import Counter

import numpy as np
import pytest

from filter_core.annotation.frame import frame_boxes_2d
from filter_core.annotation.parsing import parse_annotation
from filter_core.config.file import load_config
from filter_core.formats.reading import MANIFEST_NAME, RECORDING_NAME
from filter_core.formats.recorders import recorders
from filter_core.formats.recording import description_text
from filter_core.formats.registry import describe_source, read_source
from filter_core.images.header import read_image_header
from filter_core.local import filter_one, filter_source
from tests.support.folders import annotation_of, write_files
from tests.support.pictures import pixels_of, png
from tests.support.shared_data import shared


def npz(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


CORNERS = [[x, y, z] for z in (5.0, 6.0) for y in (10, 20) for x in (30, 50)]
BOX = {"location": {"x": 20, "y": 0, "z": 1.5}, "extent": {"x": 1, "y": 1, "z": 1}}
ORIGIN = {"Location": {"x": 0, "y": 0, "z": 0}, "Rotation": {"yaw": 0}}
MOUNT = {"sensor_name": "CAM_FRONT", "translation": [0, 0, 1.5]}
CARLA = {"xmin": 1, "ymin": 2, "xmax": 30, "ymax": 40}
KINDS, SIDES = ("semantic", "instance", "depth"), ("front", "top_down")


def gzipped(value):
    return gzip.compress(json.dumps(value).encode())


def cube(centre, half):
    """The corners of a box along the axes of the world."""
    signs = itertools.product((-1, 1), repeat=3)
    return (np.array(centre) + np.array(half) * np.array(list(signs))).tolist()


INTRINSIC = [[800, 0, 800], [0, 800, 450], [0, 0, 1]]
FORWARD = [[1, 0, 0, -10], [0, 1, 0, -20], [0, 0, 1, -2], [0, 0, 0, 1]]
"""World to camera at (10, 20, 2), which looks along x."""
BACKWARD = [[-1, 0, 0, 10], [0, -1, 0, 20], [0, 0, 1, -2], [0, 0, 0, 1]]
EGO = {"class": "ego_vehicle", "id": "1", "world_cord": cube([10, 20, 1], [2, 1, 1])}
VEHICLE = {
    "class": "vehicle",
    "id": "217",
    "type_id": "vehicle.audi.tt",
    "location": [20, 21, 0],
    "center": [20, 21, 1],
    "extent": [2, 1, 1],
    "rotation": [0.0, 0.0, 0.0],
    "world_cord": cube([20, 21, 1], [2, 1, 1]),
    "distance": 10.1,
    "base_type": "car",
    "num_points": 3,
}
LIGHT = {
    "class": "traffic_light",
    "id": "30",
    "type_id": "traffic.traffic_light",
    "location": [30, 18, 6],
    "center": [30, 18, 6],
    "extent": [0.2, 0.5, 1.0],
    "rotation": [0.0, 0.0, 90.0],
    "distance": 20.1,
}
LENS = {"intrinsic": INTRINSIC, "fov": 90.0, "image_size_x": 1600, "image_size_y": 900}
SENSORS = {
    name: {**LENS, "world2cam": matrix}
    for name, matrix in {"CAM_FRONT": FORWARD, "CAM_BACK": BACKWARD}.items()
}
OBJECTS = [EGO, VEHICLE, LIGHT]
ANNO = {"x": 10.0, "weather": {}, "bounding_boxes": OBJECTS, "sensors": SENSORS}
KITTI_3D = "1.5 1.6 4 1 2 20 0.1"
TRACKS = f"""0 2 Car 0 0 -1.57 296.75 161.75 455.25 292.5 {KITTI_3D}
0 -1 DontCare -1 -1 -10 219.5 188.5 245.5 218.5 -1000 -1000 -1000 -10 -1 -1 -1
1 2 Van 0 0 -1.6 294 156 452 284 {KITTI_3D}
"""
BOX2D = {"x1": 10.0, "y1": 5.0, "x2": 19.0, "y2": 15.0}
SCALABEL = {"category": "car", "box2d": BOX2D, "attributes": {}}
FOCAL = {"focal": [640, 640], "center": [640, 400], "skew": 0}
SCALABEL_FRAMES = [
    {
        "name": "00000000_img_front.jpg",
        "videoName": video,
        "intrinsics": FOCAL,
        "labels": labels,
    }
    for video, labels in {
        "0003-17fb": [{"id": "7", **SCALABEL}],
        "0004-aaaa": None,
    }.items()
]
SELMAS_BOX = {**BOX, "label": 100, "bp_id": "vehicle.a.b", "instance_id": "7"}
CARLAS_CAR = {"class": "car", "blueprint_id": "a"}
CARLAS_OBJECTS = [
    {"id": 5, **CARLAS_CAR, "bbox_2d": CARLA},
    {"id": 6, **CARLAS_CAR, "bbox_2d": None},
]
REMOVED = [[[5, 6], [7, 8]]] * 2
CARLA_2DBBOX = {
    "bboxes": [[[1.5, 2], [3, 4]]],
    "vehicle_class": [1],
    "removed_bboxes": REMOVED,
    "removed_vehicle_class": [0, 0],
}
RECORDED: dict[str, dict[str, str | bytes | None]] = {
    "carla-dataset-runner": {
        **dict.fromkeys(("rgb20191104-1.jpeg", "sem20191104-1.png")),
        "bb20191104-1.npz": npz(arr_0=[CORNERS], arr_1=np.zeros((0, 8, 3))),
    },
    "SELMA": {
        **dict.fromkeys(("CAM_FRONT/T_1.jpg", "SEGCAM_FRONT/T_1.png")),
        "DEPTHCAM_FRONT/T_1.png": None,
        "BBOX_LABELS/T_1.json": json.dumps([SELMAS_BOX]),
        "calibrated_sensor.json": json.dumps([{**MOUNT, "rotation": {"pitch": -5}}]),
        "waypoints.json": json.dumps({"1": ORIGIN}),
    },
    "CARLA's bounding_boxes.py": {
        "00000123.png": None,
        "123.json": json.dumps(
            {"frame_id": 123, "timestamp": 1.5, "objects": CARLAS_OBJECTS}
        ),
    },
    "Bench2Drive": {
        **dict.fromkeys(f"camera/{kind}_front/00007.png" for kind in KINDS),
        **dict.fromkeys(f"camera/rgb_{side}/00007.jpg" for side in SIDES),
        "anno/00007.json.gz": gzipped({**ANNO, "bounding_boxes": [EGO, VEHICLE]}),
        "expert_assessment/00006.npz": npz(arr_0=np.zeros(3)),
    },
    "KITTI's tracking format": {
        "image_02/0001/000000.png": None,
        "label_02/0001.txt": "\n".join(TRACKS.splitlines()[:2]),
        "calib/0001.txt": "P2: 1 0 0 0 0 1 0 0 0 0 1 0",
        "oxts/0001.txt": "49.0 8.4 112.8",
    },
    "SHIFT": {
        "front/img/0003-17fb/00000000_img_front.jpg": None,
        "front/semseg/0003-17fb/00000000_semseg_front.png": None,
        "front/depth/0003-17fb/00000000_depth_front.png": None,
        "front/det_2d.json": json.dumps({"frames": SCALABEL_FRAMES[:1]}),
    },
    "CARLA-2DBBox": {
        **dict.fromkeys(("out_rgb/000007.png", "out_rgb_bbox/000007.png")),
        "out_bbox/000007.txt": json.dumps(CARLA_2DBBOX),
    },
}
TRACK: dict[str, object] = {"id": "2", "xyxy": [296.75, 161.75, 455.25, 292.5]}
READ: dict[str, tuple[str, str, dict[str, object]]] = {
    "carla-dataset-runner": ("20191104-1", "vehicle", {"xyxy": [30, 10, 50, 20]}),
    "SELMA": ("T/FRONT/1", "car", {"instance_id": 7, "type_id": "vehicle.a.b"}),
    "CARLA's bounding_boxes.py": ("00000123", "car", {"xyxy": [1, 2, 30, 40]}),
    "Bench2Drive": ("front/00007", "vehicle", {"id": "217", "distance": 10.1}),
    "KITTI's tracking format": ("0001/000000", "Car", TRACK),
    "SHIFT": ("front/0003-17fb/00000000", "car", {"id": "7", "xyxy": [10, 5, 20, 16]}),
    "CARLA-2DBBox": ("000007", "truck", {"xyxy": [1.5, 2, 3, 4]}),
}


@pytest.mark.parametrize("folder", ["", "a run/"])
@pytest.mark.parametrize("name", RECORDED)
def test_recording_is_recognised_and_its_recorder_is_said(tmp_path, name, folder):
    files = {f"{folder}{path}": file for path, file in RECORDED[name].items()}

    frames = read_source(write_files(tmp_path, files))
    (frame,) = frames

    key, class_name, values = READ[name]
    assert frames.notes()[0].startswith(f"recognised as a recording of {name}")
    assert frame.key.endswith(key)
    assert [file.path for file in frames.unmatched] == []
    (box,) = annotation_of(frame)["boxes"]
    assert box["class"] == class_name
    assert values.items() <= box.items()


@pytest.mark.parametrize("name", RECORDED)
def test_description_of_a_recorder_is_written_and_read_back(tmp_path, name):
    write_files(tmp_path, RECORDED[name])
    description = describe_source(tmp_path)
    (frame,) = read_source(tmp_path)

    text = description_text(description, tmp_path)
    write_files(tmp_path, {RECORDING_NAME: text})
    (again,) = read_source(tmp_path)

    assert annotation_of(again) == annotation_of(frame)
    assert describe_source(tmp_path).config_keys() == description.config_keys()
    assert len(text.splitlines()) < 60


@pytest.mark.parametrize(
    ("files", "layout"),
    [
        ({RECORDING_NAME: "layout: pairs"}, "pairs"),
        ({MANIFEST_NAME: '{"key": "1", "boxes": []}'}, "manifest"),
        ({"bb20191104-1.npz": b"something else"}, "pairs"),
    ],
)
def test_description_manifest_or_other_content_is_no_recorders(tmp_path, files, layout):
    frames = read_source(
        write_files(tmp_path, {**RECORDED["carla-dataset-runner"], **files})
    )

    assert frames.layout == layout
    assert not any("recognised as a recording" in note for note in frames.notes())


def test_options_win_over_the_recorders_description(tmp_path):
    write_files(tmp_path, RECORDED["carla-dataset-runner"])

    assert describe_source(tmp_path).palette == "carla-0.9.0"
    option = describe_source(tmp_path, options={"palette": "carla-0.9.10"})
    assert (option.palette, option.own_layout) == ("carla-0.9.10", "table")
    assert describe_source(tmp_path, options={"layout": "pairs"}).recorder == ""
    # Every recorder that ships is tested here.
    assert {recorder.name.split(" (")[0] for recorder in recorders()} == {*RECORDED}


def test_recorded_npz_boxes_have_the_verdicts_that_were_counted():
    folder = shared("cases/recordings/alannaoto")
    description = describe_source(folder)
    config = load_config("profile: paper", below=description.config_keys()).config

    outcomes = filter_source(read_source(folder), config, workers=1)

    verdicts = {
        outcome.key: Counter(each["verdict"] for each in outcome.decisions or ())
        for outcome in outcomes
    }
    assert verdicts == {
        "20191104-142916": {"kept": 25, "rejected": 46},
        "20191104-142925": {"kept": 14, "rejected": 35},
        "20191104-171700": {"kept": 15, "rejected": 18},
    }


TAGS: dict[str, tuple[int, ...]]
TAGS = {"person": (40,), "car": (100,), "truck": (101,), "train": (103,)}
TAGS |= {"motorcycle": (104, 41), "bicycle": (105, 41)}


@pytest.mark.parametrize("below", ["", "Town01_Opt_ClearNight"])
def test_recorded_3d_boxes_lie_where_their_cameras_show_them(below):
    frames = read_source(shared("cases/recordings/selma") / below)
    description = describe_source(shared("cases/recordings/selma") / below)
    config = load_config("profile: paper", below=description.config_keys()).config
    visible, kept = {}, {}
    for frame in frames:
        annotation = parse_annotation(annotation_of(frame))
        assert frame.segmentation is not None
        tags = pixels_of(frame.segmentation.read_bytes())
        tags = tags if tags.ndim == 2 else tags[..., 0]
        xyxy = frame_boxes_2d(annotation, (1280, 640)).xyxy
        areas = [pixels(row) for row in xyxy]
        shares = [
            np.isin(tags[rows, columns], TAGS[box.class_name or ""]).mean()
            for box, (rows, columns) in zip(annotation.boxes, areas, strict=True)
            if tags[rows, columns].size
        ]
        camera = frame.key.split("/")[-2]
        visible[camera] = sum(share >= 0.1 for share in shares)
        decisions = filter_one(frame, config).decisions or ()
        kept[camera] = sum(each["verdict"] == "kept" for each in decisions)
        assert len(annotation.boxes) == 212
        assert set(frame.others) == {"depth"}

    assert visible == kept == {"FRONT": 16, "LEFT": 35}


def pixels(xyxy):
    """Rows and columns that a rectangle touches."""
    x_min, y_min = np.maximum(np.floor(xyxy[:2]), 0).astype(int)
    x_max, y_max = np.maximum(np.ceil(xyxy[2:]), 0).astype(int)
    return slice(y_min, y_max), slice(x_min, x_max)


def projected(corners, world_to_camera, intrinsic):
    """The rectangle around corners in front of a camera, by the pinhole model."""
    points = np.array([*zip(*corners, strict=True), [1] * len(corners)])
    x, y, z, _ = np.array(world_to_camera) @ points
    (focal, _, u), (_, _, v), _ = intrinsic
    across, down = u + focal * y / x, v - focal * z / x
    return [across.min(), down.min(), across.max(), down.max()]


def test_bench2drives_boxes_lie_where_each_of_its_cameras_shows_them(tmp_path):
    run = tmp_path / "Parking_Town05_Route68_Weather8"
    for camera in ("front", "back"):
        pictures = (f"camera/{kind}_{camera}/00007.png" for kind in KINDS)
        write_files(run, {f"camera/rgb_{camera}/00007.jpg": None})
        write_files(run, dict.fromkeys(pictures))
    write_files(run, {"anno/00007.json.gz": gzipped(ANNO)})

    back, front = read_source(tmp_path)

    boxes = {}
    for frame in (front, back):
        annotation = parse_annotation(annotation_of(frame))
        assert annotation.map == "Town05"
        assert [box.id for box in annotation.boxes] == ["217", "30"]
        boxes[frame.key.split("/")[-2]] = frame_boxes_2d(annotation, (1600, 900)).xyxy
    # Turned by 90 degrees, the light's half sizes along x and y are exchanged.
    solids = [VEHICLE["world_cord"], cube([30, 18, 6], [0.5, 0.2, 1.0])]
    seen = [projected(solid, FORWARD, INTRINSIC) for solid in solids]
    assert boxes["front"] == pytest.approx(np.array(seen))
    assert (boxes["back"] < 0).all()  # behind it


def test_tracks_of_kitti_belong_to_the_frames_of_their_sequence(tmp_path):
    names = ("0000/000000", "0000/000001", "0001/000000", "0002/000000")
    write_files(tmp_path, {f"image_02/{name}.png": None for name in names})
    write_files(tmp_path, {"label_02/0000.txt": TRACKS, "label_02/0001.txt": ""})

    recording = read_source(tmp_path)
    frames = {frame.key: annotation_of(frame) for frame in recording}

    assert [*frames] == [*names[:3]]
    assert [file.path for file in recording.unmatched] == ["image_02/0002/000000.png"]
    first, second, third = frames.values()
    assert first["boxes"] == [{**TRACK, "class": "Car"}]
    assert first["dontcare"] == [[219.5, 188.5, 245.5, 218.5]]
    assert second["boxes"] == [
        {"id": "2", "class": "Van", "xyxy": [294, 156, 452, 284]}
    ]
    assert third == {"boxes": []}


def test_frames_of_shift_are_told_by_their_video(tmp_path):
    """Each video has a frame of the same name."""
    videos = ("0003-17fb", "0004-aaaa")
    name = "discrete/images/val/front/img/{}/00000000_img_front.jpg"
    write_files(tmp_path, {name.format(video): None for video in videos})
    labels = json.dumps({"config": {}, "frames": SCALABEL_FRAMES})
    write_files(tmp_path, {"discrete/images/val/front/det_2d.json": labels})

    first, second = (annotation_of(frame)["boxes"] for frame in read_source(tmp_path))

    assert [box["xyxy"] for box in first] == [[10, 5, 20, 16]]
    assert second == []


VOC = """<annotation>
    <folder>output</folder>
    <filename>023235.png</filename>
    <path>/home/matt/Documents/temp/output/023235.png</path>
    <source><database>Unknown</database></source>
    <size><width>800</width><height>600</height><depth>3</depth></size>
    <segmented>0</segmented>
    <object>
        <name>vehicle</name><pose>Unspecified</pose>
        <truncated>0</truncated><difficult>0</difficult>
        <bndbox>
            <xmin>503.25</xmin><ymin>310.5</ymin><xmax>511.75</xmax><ymax>321.125</ymax>
        </bndbox>
    </object>
</annotation>"""
COCO = {
    "info": {},
    "licenses": [{"url": "", "id": 1, "name": "Attribution"}],
    "images": [
        {"license": 1, "file_name": "023235.png", "height": 600, "width": 800,
         "date_captured": "2022-04-14 17:02:52", "id": 23235},
    ],
    "categories": [{"supercategory": "vehicle", "id": 10, "name": "vehicle"}],
    "annotations": [
        {"segmentation": [], "area": 9262.89, "iscrowd": 0, "image_id": 23235,
         "category_id": 10, "bbox": [503.25, 310.5, 8.5, 10.625]},
    ],
}  # fmt: skip
SMALL = png(np.zeros((600, 800, 3), np.uint8))
CARLA_DATA_EXPORT = (
    "Car 0 0 -10 503.25 310.5 511.75 321.125 1.5 1.8 4.2 2.5 1.25 30.5 1.57\n"
)
MATRIX = "624.0 0.0 624.0 0.0 0.0 624.0 192.0 0.0 0.0 0.0 1.0 0.0"
CALIBRATION = (
    *(f"P{number}: {MATRIX}" for number in range(4)),
    "R0_rect: 1.0 0.0 0.0 0.0 1.0 0.0 0.0 0.0 1.0",
    "Tr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0",
    "TR_imu_to_velo: 1.0 0.0 0.0 0.0 0.0 1.0 0.0 0.0 0.0 0.0 1.0 0.0",
)
USUAL = {
    "voc": {"output/023235.png": SMALL, "output/023235.xml": VOC},
    "coco": {"023235.png": SMALL, "simulation_data.json": json.dumps(COCO)},
    "kitti": {
        "training/image_2/000000.png": png(np.zeros((384, 1248, 3), np.uint8)),
        "training/label_2/000000.txt": CARLA_DATA_EXPORT,
        "training/calib/000000.txt": "\n".join(CALIBRATION),
        "training/planes/000000.txt": "# Plane\nWidth 4\nHeight 1\n0 -1 0 1.8",
        "training/velodyne/000000.bin": b"\0" * 16,
        "training/train.txt": "000000\n",
    },
}


@pytest.mark.parametrize("layout", USUAL)
def test_recorders_that_write_a_usual_format_need_no_description(tmp_path, layout):
    """Structures of CARLA's tutorial ``tuto_G_bounding_boxes`` and of Ozzyz's
    carla-data-export (``dataexport.py``, ``datadescriptor.py``)."""
    recording = read_source(write_files(tmp_path, USUAL[layout]))
    (frame,) = recording

    annotation = parse_annotation(annotation_of(frame))
    (box,) = annotation.boxes
    assert frame.image is not None
    size = read_image_header(frame.image.read_bytes()).wh
    xyxy = frame_boxes_2d(annotation, size).xyxy
    name = "Car" if layout == "kitti" else "vehicle"
    assert (recording.layout, box.class_name) == (layout, name)
    assert xyxy.tolist() == [[503.25, 310.5, 511.75, 321.125]]
    assert [file.path for file in recording.unmatched] == []
