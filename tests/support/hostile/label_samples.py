"""Valid configurations, annotations and folders of labels, for fuzzers to damage."""

from tests.support.exporting import box, export, frame

YAML = """\
# every kind of value
profile: paper
threshold_small_box: 10
threshold_big_box: 2.5e1
palette: carla-0.9.14
min_distance: ~
evidence: {pedestrian: semantic}
classes:
  car: {accept: [Car, Truck], threshold_small_box: 40}
  walker: {accept: [12]}
"""
CARLASIMU = """\
sitting:
  boundingBox: {min_distance: 2, max_distance: 200, size_big_box: 15}
  cam_rgb: {3D: true, width: 1280}
"""
ZERO_POSE = dict.fromkeys(("x", "y", "z", "pitch", "yaw", "roll"), 0)
CAMERA = {"width": 80, "height": 60, "fov": 90, "transform": ZERO_POSE}
PLACE = {"x": 10, "y": 0, "z": 1}
LEVEL = {"pitch": 0, "yaw": 0, "roll": 0}
BOX3D = {
    "transform": {**PLACE, **LEVEL},
    "extent": PLACE,
    "location": PLACE,
    "rotation": LEVEL,
}
CORNERS = [[x, y, z] for x in (8, 12) for y in (-1, 1) for z in (0, 2)]
ANNOTATION = {
    "key": "a",
    "carla_version": "0.9.15",
    "captured_at": "2026-01-01T00:00:00Z",
    "camera": CAMERA,
    "sensors": {"lidar": {"transform": ZERO_POSE}},
    "boxes": [
        {"id": "1", "class": "car", "xyxy": [1, 2, 30, 40], "distance": 12.5},
        {"id": 2, "type_id": "vehicle.ford.ambulance", "xywh": [10, 20, 30, 40]},
        {"class": "van", "cxcywhn": [0.5, 0.5, 0.1, 0.1], "instance_id": 4711},
        {"class": "car", "vertices": CORNERS},
        {"class": "car", "box3d": BOX3D, "extra": {"a": [None, True]}},
    ],
}


def _samples() -> dict[str, dict[str, bytes]]:
    """The files of a small valid folder of each layout."""
    frames = [
        frame("a", box(0), box(1, (50, 10, 70, 30), "rejected", distance=12.5)),
        frame("b", box(2, class_name="traffic light")),
    ]
    names = (
        *("yolo", "coco", "kitti", "voc", "manifest"),
        *("cvat", "label-studio", "decisions-jsonl"),
    )
    folders = {name: export(name, frames) for name in names}
    image = next(
        data for name, data in folders["yolo"].items() if name.endswith("a.png")
    )
    folders["carlasimu"] = {
        "labels/label50/a.txt": b"0 0.5 0.5 0.1 0.1\n",
        "labels/label100/a.txt": b"0 0.5 0.5 0.1 0.1\n1 0.1 0.1 0.2 0.2\n",
        "images/a.png": image,
        "classes.txt": b"car\nvan\n",
    }
    return folders


FOLDERS = _samples()
