"""Writes small folders of files and images for tests that read them."""

import json

import numpy as np

from tests.support.nuscenes import nuscenes_files
from tests.support.pictures import painted, png


def write_files(root, files):
    """Write files, by path below `root`, of text or bytes; None makes a small PNG."""
    for name, content in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is None:
            content = png(np.zeros((60, 80, 3), np.uint8))
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return root


def street_tags(car_xyxy=(10, 10, 50, 40), wh=(80, 60)):
    """A tag image: sky above, road below, and one car."""
    tags = np.full((wh[1], wh[0]), 11, np.uint8)
    tags[wh[1] // 2 :] = 1
    x_min, y_min, x_max, y_max = car_xyxy
    tags[y_min:y_max, x_min:x_max] = 14
    return tags


def annotation_of(frame):
    """The annotation of a frame that was read without a problem."""
    assert frame.annotation is not None, frame.problem
    return frame.annotation


YOLO_LINE = b"0 0.5 0.5 0.1 0.2\n"
BOX = {"class": "car", "cxcywhn": [0.5, 0.5, 0.1, 0.2]}
"""The box of `YOLO_LINE`, if its class is called car."""
VOC_FILE = b"""<annotation><object><name>car</name><bndbox><xmin>1</xmin><ymin>2</ymin>
<xmax>10</xmax><ymax>20</ymax></bndbox></object></annotation>"""
_COCO = {
    "images": [{"id": 1, "file_name": "7.png", "width": 80, "height": 60}],
    "annotations": [{"id": 5, "image_id": 1, "category_id": 2, "bbox": [1, 2, 3, 4]}],
    "categories": [{"id": 2, "name": "car"}],
}
_KITTI = b"Car 0.5 1 -1.57 10 20 30 40 1.5 1.6 4 1 2 20 0.1\n"
_P2 = b"P2: 40 0 40 0 0 40 30 0 0 0 1 0\n"
CVAT_FILE = b"""<?xml version="1.0" encoding="utf-8"?>
<annotations><version>1.1</version><meta><task><labels>
<label><name>car</name><attributes><attribute><name>colour</name></attribute>
</attributes></label></labels></task></meta>
<image id="0" name="a/1.png" subset="valid" width="80" height="60">
<box label="car" source="manual" occluded="1" xtl="1.00" ytl="2.00" xbr="10.50"
 ybr="20.00" z_order="0"><attribute name="colour">red</attribute></box>
<box label="car" occluded="0" xtl="20" ytl="20" xbr="30" ybr="30" rotation="90.00"/>
<polygon label="bus" occluded="0" points="1.5,2;10,2;5,8.25" z_order="1"/>
<points label="car" points="1,2"/>
</image></annotations>
"""
_REGION = {"type": "rectanglelabels", "from_name": "l", "to_name": "i", "id": "r1"}
_SIZE = {"original_width": 80, "original_height": 60}
TASK = {
    "id": 12,
    "data": {"image": "/data/upload/3/d2bf8f7a-1.png"},
    "annotations": [
        {
            "id": 4,
            "created_at": "2026-01-01T00:00:00Z",
            "result": [{**_REGION, "value": {"x": 0, "y": 0, "width": 1, "height": 1}}],
        },
        {
            "id": 5,
            "created_at": "2026-01-02T00:00:00Z",
            "result": [
                {
                    **_REGION,
                    **_SIZE,
                    "value": {
                        "x": 12.5,
                        "y": 50,
                        "width": 25,
                        "height": 10,
                        "rotation": 0,
                        "rectanglelabels": ["car"],
                    },
                },
                {
                    **_SIZE,
                    "id": "p1",
                    "type": "polygonlabels",
                    "value": {
                        "points": [[10, 10], [50, 10], [30, 90]],
                        "polygonlabels": ["bus"],
                    },
                },
                {"id": "c1", "type": "choices", "value": {"choices": ["rain"]}},
            ],
        },
        {"id": 6, "was_cancelled": True, "created_at": "2026-01-03", "result": []},
    ],
    "predictions": [],
}
"""A task as Label Studio exports it: an older annotation, one in force, one skipped."""
DECIDED = {
    "key": "a/1",
    "palette": None,
    "split": "valid",
    "camera": {"width": 80, "height": 60},
    "decisions": [
        {
            "id": "7",
            "class": "car",
            "verdict": "kept",
            "xyxy": [1, 2, 3, 4],
            "review": {
                "verdict": "reject",
                "reviewer": "ann",
                "comment": "no car",
                "created_at": "2026-01-01T00:00:00Z",
            },
        },
        {"id": "8", "class": "car", "verdict": "rejected", "xyxy": None},
    ],
}
_MANIFEST = b'{"key": "a/0", "image": "rgb/0.png", "depth": "d.npy", "boxes": []}\n'
_PICTURE = png(np.zeros((60, 80, 3), np.uint8))


def write_carlasimu(folder, boxes, bands=(50, 100, 150, 200), *, separator="/"):
    """One frame as carlasimu's script `boundingBox.py` writes it; returns its folder.

    Parameters
    ----------
    boxes : sequence of (line of a label, metres)
    bands : sequence of metres
    separator : str
        A backslash on Linux, where its paths become names of folders.
    """
    name = "00000993"
    labels = {
        f"cam/labels/label{band}/{name}.txt": "".join(
            f"{line}\n" for line, metres in boxes if metres <= band
        )
        for band in bands
    }
    readme = {
        "classes": dict(zip(("car", "bus", "truck", "van"), range(4), strict=True)),
        "box": "[x_center,y_center,width,hight]",
        "weather": "WeatherParameters(cloudiness=20.000000, fog_distance=0.750000)",
        "img_size": {"width": 80, "hight": 60},
        "distance": {"max_distance": [50, 100, 150, 200], "min_distance": 1},
        "map": "Town10HD_Opt",
    }
    picture = png(np.zeros((60, 80, 3), np.uint8))
    head = ["ply", "format ascii 1.0", "element vertex 1"]
    columns = [f"property float {axis}" for axis in "xyz"]
    points = "\n".join([*head, *columns, "end_header", "1 2 3\n"])
    files = {
        **labels,
        "cam/Readme.txt": json.dumps(readme, indent=4),
        f"seg/{name}.png": png(painted(street_tags())),
        f"depth/{name}.png": picture,
        f"radar/{name}.ply": points,
        f"lidar/{name}.ply": points,
        **{
            f"cam/{kind}/{name}.png": picture
            for kind in ("images", "images_bbox", "images_bbox_filter")
        },
    }
    return write_files(
        folder, {f"out{separator}{path}": content for path, content in files.items()}
    )


LAYOUT_FILES = {
    "yolo": {
        "data.yaml": b"names: [car]",
        "images/train/1.png": b"",
        "labels/train/1.txt": YOLO_LINE,
        "seg/1.png": b"",
    },
    "carlasimu": {
        "images/1.png": b"",
        "labels/label50/1.txt": b"",
        "labels/label200/1.txt": b"4 .5 .5 .1 .2",
        "seg/1.png": b"",
    },
    "voc": {"Annotations/1.xml": VOC_FILE, "JPEGImages/1.jpg": b""},
    "kitti": {
        "training/label_2/000000.txt": _KITTI,
        "training/image_2/000000.png": _PICTURE[:24],
        "training/calib/000000.txt": _P2,
    },
    "coco": {
        "annotations/instances_val.json": json.dumps(_COCO).encode(),
        "images/7.png": b"",
    },
    "cvat": {"annotations.xml": CVAT_FILE, "images/a/1.png": b""},
    "label-studio": {"tasks.json": json.dumps([TASK]).encode(), "images/1.png": b""},
    "decisions-jsonl": {
        "decisions.jsonl": json.dumps(DECIDED).encode(),
        "images/a/1.png": b"",
    },
    "manifest": {"manifest.jsonl": _MANIFEST, "rgb/0.png": b"", "d.npy": b""},
    "nuscenes": nuscenes_files("front"),
    "table": {
        "1.png": b"",
        "boxes.csv": b"image,label,x1,y1,x2,y2\n1.png,car,1,2,3,4\n",
    },
    "pairs": {
        "1.png": b"",
        "1_seg.png": b"",
        "1.json": json.dumps({"boxes": [BOX]}).encode(),
    },
}
"""By layout: the files of a small folder, without the content of most images."""


def mixed_recording(root):
    """A YOLO folder with all that somebody may want to correct before it is used.

    Three parts, raw tags of which one (100) is not known, classes that the filter does
    not know, a box outside of the image, pictures without labels, and other files.
    """
    names = b"names: [car, walker, Kasten, Caar, bus]\n"
    labels = (
        b"0 0.21875 0.305 0.3125 0.39\n"  # its pixels are a car's
        b"0 0.71875 0.6944 0.1875 0.2778\n"  # a car's, and a few of tag 100
        b"1 0.6 0.2 0.1 0.3\n2 0.3 0.8 0.1 0.1\n3 0.9 0.8 0.1 0.1\n"
    )
    tags = street_tags((20, 20, 120, 90), (320, 180))
    tags[100:150, 200:260] = 14
    tags[100:116, 200:216] = 100
    picture = png(np.full((180, 320, 3), (90, 120, 60), np.uint8))
    files = {"data.yaml": names, "README.md": b"", "lidar/0.bin": b""}
    for part, count in (("train", 14), ("valid", 4), ("test", 3)):
        for number in range(count):
            outside = b"4 1.5 0.5 0.1 0.1\n" if number == 1 else b""
            files[f"{part}/images/{number:03}.png"] = picture
            files[f"{part}/seg/{number:03}.png"] = png(tags)
            files[f"{part}/labels/{number:03}.txt"] = labels + outside
    files |= {f"train/images/more{number:02}.png": picture for number in range(25)}
    files["recording.yaml"] = b"segmentation: {palette: carla-0.9.14}\n"
    return write_files(root, files)
