"""Writes small folders of files and images for tests that read them."""

from __future__ import annotations

import json

import numpy as np

from tests.support.pictures import png


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
_MANIFEST = b'{"key": "a/0", "image": "rgb/0.png", "depth": "d.npy", "boxes": []}\n'
_PICTURE = png(np.zeros((60, 80, 3), np.uint8))
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
    "manifest": {"manifest.jsonl": _MANIFEST, "rgb/0.png": b"", "d.npy": b""},
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
