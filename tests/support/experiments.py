"""A small recording and a trainer for experiments that take no time."""

import json
import sys
from pathlib import Path

from tests.support.pictures import painted, png
from tests.support.sensors import ANNOTATION, depth_png, instance_png, scene

# What it was taught is what it detects: every box of the first image, in each image.
_PARROT = """
import json, os, sys, time
from pathlib import Path
data, seed, output = Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
train, val = (
    json.loads((data / "annotations" / f"instances_{part}.json").read_text())
    for part in ("train", "val")
)
first = train["images"][0]["id"]
taught = [one for one in train["annotations"] if one["image_id"] == first]
found = [
    {"image_id": Path(image["file_name"]).stem, "category_id": one["category_id"],
     "bbox": one["bbox"], "score": 1 / one["bbox"][2] + seed / 1000}
    for image in val["images"] for one in taught
]
runs = Path(sys.argv[4])
with runs.open("a") as log:
    log.write(f"{data.name} {seed}\\n")
(runs.parent / f"pid-{os.getpid()}").touch()
while (runs.parent / "hold").exists():
    time.sleep(0.05)
(output / "predictions.json").write_text(json.dumps(found))
"""


def write_recording(folder: Path) -> Path:
    """Write eight frames of a car and a ghost behind it; four are for validation."""
    tags, metres, ids = scene()
    folder.mkdir()
    files = {
        "image": png(painted(tags)),
        "segmentation": png(painted(tags)),
        "depth": depth_png(metres),
        "instances": instance_png(tags, ids),
    }
    for kind, content in files.items():
        (folder / f"{kind}.png").write_bytes(content)
    paths = {kind: f"{kind}.png" for kind in files}
    lines = [
        json.dumps({"key": f"{part}/{number:04}", "split": part, **paths, **ANNOTATION})
        for part in ("train", "val")
        for number in range(4)
    ]
    (folder / "manifest.jsonl").write_text("\n".join(lines))
    return folder


def parrot(folder: Path) -> str:
    """The command of a trainer that notes its runs in `runs.txt` of a folder.

    It creates a file `pid-N` for its process, and waits while there is a file `hold`.
    """
    script = folder / "parrot.py"
    script.write_text(_PARROT)
    command = f"{sys.executable} {script}"
    return f"{command} {{data}} {{seed}} {{output}} {folder / 'runs.txt'}"
