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
