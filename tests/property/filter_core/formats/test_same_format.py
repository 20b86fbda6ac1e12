"""A recording in its own format loses the rejected boxes, and nothing else.

Hostile recordings are drawn as pieces of files, so that what must be left is known
without reading them.
"""

import json
import re
import tempfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from urllib.parse import unquote
from uuid import uuid4

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from filter_core.config.filter import FilterConfig
from filter_core.formats.registry import FORMATS, read_source
from filter_core.formats.same import RecordingCopy
from filter_core.local import outcomes
from tests.support.folders import street_tags, write_files
from tests.support.pictures import jpeg, painted, png
from tests.support.servers import RunningServer
from unghost.cli.sources import outgoing
from unghost.client.client import Client
from unghost.wire.words import ExportFormat

SEGMENTATION = png(painted(street_tags(), "carla-0.9.14"))
PICTURES = {
    ".png": png(np.full((60, 80, 3), (90, 120, 60), np.uint8)),
    ".jpg": jpeg(np.full((60, 80, 3), (90, 120, 60), np.uint8)),
}
CONFIG = FilterConfig.from_mapping({"profile": "paper", "palette": "carla-0.9.14"})


FEW = max(settings().max_examples // 4, 3)
"""Examples that go through a server, which takes a second for each."""


@dataclass(frozen=True)
class Kind:
    """A box, its class, and whether the filter rejects it; see `street_tags`."""

    xyxy: tuple[float, float, float, float]
    name: str = "car"
    is_rejected: bool = False


VISIBLE = Kind((12, 12, 40, 38))
KINDS = [
    VISIBLE,
    Kind((-5, 12, 31.5, 38)),  # the border cuts it
    Kind((12, 12, 40, 38), "dragon"),  # unmeasured
    Kind((56, 2, 75, 25), is_rejected=True),  # a ghost in the sky
    Kind((-30, -30, -10, -12), is_rejected=True),  # outside of the image
    Kind((60.25, 8, 60.25, 20.5), is_rejected=True),  # without a pixel
]
CLASSES = ("car", "dragon")
NUMBERS: list[Callable[[float], str]] = [
    str,
    "{:.2f}".format,
    "{:.6f}".format,
    "{:e}".format,
    "{:.9f}".format,
]
NAMES = ["000000", "a", "Ünï ☃", "sub/b", "深い/x.y", "7", "-x"]
COMPANIONS = {
    "README.md": b"no new line at the end",
    "velodyne/000000.bin": bytes(range(256)),
    ".hidden/state": b"\x00\x01",
    "notes/ReadMe": b"a\r\nb",
}
ENDS = st.sampled_from(["\n", "\r\n"])


@dataclass
class Recording:
    """The bytes of files, by name, and those that must be left of label files."""

    files: dict[str, bytes] = field(default_factory=dict)
    left: dict[str, bytes] = field(default_factory=dict)

    def add(self, name, *pieces):
        """Add a file; of its pieces, pairs are text and whether it is a ghost."""
        pairs = [line if isinstance(line, tuple) else (line, False) for line in pieces]
        self.files[name] = b"".join(piece for piece, _ in pairs)
        self.left[name] = b"".join(piece for piece, is_ghost in pairs if not is_ghost)

    def add_frame(self, folder, tags, name, suffix):
        """Add a picture and its segmentation; beside `a` there is another picture."""
        for each in PICTURES if name == "a" else [suffix]:
            self.add(f"{folder}/{name}{each}", PICTURES[each])
        self.add(f"{tags}/{name}.png", SEGMENTATION)


FRAMES = st.dictionaries(
    st.sampled_from(NAMES),
    st.tuples(
        st.lists(st.sampled_from(KINDS), max_size=5), st.sampled_from([".png", ".jpg"])
    ),
    min_size=1,
    max_size=4,
)


@st.composite
def lines_of(draw, kinds, line):
    """The lines of a label file, with blank ones, either end and perhaps none."""
    end = draw(ENDS)
    parts = [(b"\xef\xbb\xbf", False)] if draw(st.booleans()) else []
    for number, kind in enumerate(kinds):
        is_last = number == len(kinds) - 1
        text = line(kind, draw(st.sampled_from(NUMBERS)))
        tail = "" if is_last and draw(st.booleans()) else end
        parts.append(((text + tail).encode(), kind.is_rejected))
        if tail and draw(st.integers(0, 4)) == 0:
            parts.append((f"  {end}".encode(), False))
    return parts


def yolo_line(kind, number):
    x0, y0, x1, y1 = kind.xyxy
    shares = ((x0 + x1) / 160, (y0 + y1) / 120, (x1 - x0) / 80, (y1 - y0) / 60)
    return f" {CLASSES.index(kind.name)} " + "\t".join(map(number, shares)) + " "


@st.composite
def yolo(draw):
    recording = Recording()
    end = draw(ENDS)
    recording.add(
        "data.yaml",
        f"path: /data/x{end}train: images/train{end}nc: 2 # two{end}"
        f"names: [car, 'dragon']{end}roboflow: {{version: 3}}".encode(),
    )
    for name, (kinds, suffix) in draw(FRAMES).items():
        part = draw(st.sampled_from(["train", "valid"]))
        recording.add_frame(f"images/{part}", f"seg/{part}", name, suffix)
        lines = draw(lines_of(kinds, yolo_line))
        recording.add(f"labels/{part}/{name}.txt", *lines)
        if draw(st.booleans()):  # of a distance band
            near = [line for number, line in enumerate(lines) if number % 2 == 0]
            recording.add(f"label50/{part}/{name}.txt", *near)
    return recording


def kitti_line(kind, number):
    edges = " ".join(map(number, kind.xyxy))
    return f"{kind.name} 0.10 2 -1.570 {edges} 1.5 1.60 4 1.00 2 20.0 0.1"


REGION = b"DontCare -1 -1 -10 1.50 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10\n"


@st.composite
def kitti(draw):
    recording = Recording()
    calibration = "".join(
        f"{name}: 7.215377e+01 0 40 -45.75 0 72.15 30 0.2 0 0 1 2.7e-3{draw(ENDS)}"
        for name in ("P0", "P1", "P2", "P3", "Tr_velo_to_cam")
    )
    for name, (kinds, suffix) in draw(FRAMES).items():
        recording.add_frame("training/image_2", "training/semantic", name, suffix)
        lines = draw(lines_of(kinds, kitti_line))
        ends = not lines or lines[-1][0].endswith((b"\n", b"\xbf"))
        regions = [REGION] * ends * draw(st.integers(0, 2))
        recording.add(f"training/label_2/{name}.txt", *lines, *regions)
        if draw(st.booleans()):
            recording.add(f"training/calib/{name}.txt", calibration.encode())
    listed = "\n".join(NAMES)
    recording.add("ImageSets/train.txt", listed.encode())
    return recording


OBJECTS = [
    "<object name='{name}'><name>{name}</name><!-- > --><bndbox>{box}</bndbox>"
    "<part><name>wheel</name></part></object>",
    "<object>\n\t\t<bndbox>{box}</bndbox>\n\t\t<name>{name}</name>"
    "<difficult>1</difficult><mine><![CDATA[<object>]]></mine>\n\t</object >",
]


@st.composite
def voc(draw):
    recording = Recording()
    for name, (kinds, suffix) in draw(FRAMES).items():
        recording.add_frame("JPEGImages", "seg", name, suffix)
        end = draw(ENDS)
        encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "latin-1"]))
        declared = encoding.removesuffix("-sig").upper().replace("LATIN", "ISO-8859")
        image = f"<filename>{name.rpartition('/')[2]}{suffix}</filename>"
        head = (
            f"<?xml version='1.0' encoding='{declared}'?>{end}"
            f"<annotation verified='yes'>{end}\t<folder>x</folder>"
            f"{image if name in ('000000', 'a', 'sub/b') else ''}"
            "<path>C:\\x\\ü.jpg</path><owner/>"
            "<source><database>mine</database></source>"
        )
        parts: list[object] = [head.encode(encoding)]
        for kind in kinds:
            number = draw(st.sampled_from(["{:.0f}", "{:.2f}"]))
            sides = ("xmin", "ymin", "xmax", "ymax")
            corners = (x + (n < 2) for n, x in enumerate(kind.xyxy))
            box = "".join(
                f"<{side}>{number.format(corner)}</{side}>"
                for side, corner in zip(sides, corners, strict=True)
            )
            text = draw(st.sampled_from(OBJECTS)).format(name=kind.name, box=box)
            space = draw(st.sampled_from(["", f"{end}\t"]))
            parts.append((f"{space}{text}".encode("latin-1"), kind.is_rejected))
            if draw(st.booleans()):
                parts.append(b"<!-- kept -->")
        parts.append(f"{end}</annotation>{draw(st.sampled_from(['', end]))}".encode())
        recording.add(f"Annotations/{name}.xml", *parts)
    return recording


def annotation_text(draw, number, image_id, kind):
    x0, y0, x1, y1 = kind.xyxy
    write = draw(st.sampled_from(NUMBERS))
    bbox = ", ".join(map(write, (x0, y0, x1 - x0, y1 - y0)))
    more = draw(
        st.sampled_from(
            [
                "",
                ', "iscrowd": 1, "segmentation": {"size": [60, 80], "counts": [0, 4]}',
                ', "attributes": {"ü": 1.50}, "id2": 1e2, "area": 7.0',
            ]
        )
    )
    return (
        f'{{"id": {number * 7 + 3}, "image_id": {image_id},  "bbox": [{bbox}],'
        f'"category_id": {CLASSES.index(kind.name) * 40 + 90}{more}}}'
    )


@st.composite
def coco(draw):
    recording = Recording()
    images, annotations = [], []
    for number, (name, (kinds, suffix)) in enumerate(draw(FRAMES).items()):
        recording.add_frame("images", "seg", name, suffix)
        images.append(
            f'{{"file_name": {json.dumps(name + suffix)}, "id": {900 - number}, '
            '"width": 80, "height": 60, "license": 4, "captured": 1.10}'
        )
        annotations += [(900 - number, kind) for kind in kinds]
    annotations = draw(st.permutations(annotations))
    comma = draw(st.sampled_from([",", ", ", ",\r\n  ", " ,\n"]))
    pieces = []
    for number, (image, kind) in enumerate(annotations):
        pieces.append((annotation_text(draw, number, image, kind), kind.is_rejected))
    lists = {
        "info": '{"year": 2024, "ü": "é", "version": 1.0}',
        "videos": '[{"id": 1, "name": "v"}]',
        "images": f"[{comma.join(images)}]",
        "annotations": None,
        "categories": '[{"id": 130, "name": "dragon", "supercategory": "beast"},'
        ' {"id": 90, "name": "car", "keypoints": ["a"]}]',
        "licenses": "[ ]",
    }
    keys = draw(st.permutations(list(lists)))
    mark = draw(st.sampled_from(["", "\ufeff"]))

    space, end = draw(st.sampled_from(["", "\n "])), draw(ENDS)

    def text(boxes):
        written = {**lists, "annotations": f"[{space}{comma.join(boxes)}{space}]"}
        body = comma.join(f'"{key}": {written[key]}' for key in keys)
        return f"{mark}{{{body}}}{end}".encode()

    name = "annotations/instances_train.json"
    recording.files[name] = text([line for line, _ in pieces])
    recording.left[name] = text([line for line, is_ghost in pieces if not is_ghost])
    return recording


@st.composite
def manifest(draw):
    recording = Recording()
    whole, left = [], []
    for name, (kinds, suffix) in draw(FRAMES).items():
        recording.add_frame("rgb", "seg", name, suffix)
        comma, end = draw(st.sampled_from([",", " , "])), draw(ENDS)
        boxes = []
        for number, kind in enumerate(kinds):
            edges = ",".join(map(draw(st.sampled_from(NUMBERS)), kind.xyxy))
            box = f'"id": {number}, "class":"{kind.name}", "xyxy": [{edges}], "?": 1.0'
            boxes.append((f"{{{box}}}", kind.is_rejected))
        paths = {"image": f"rgb/{name}{suffix}", "segmentation": f"seg/{name}.png"}
        head = json.dumps({"key": name, **paths, "weather": {"rain": 0.5}})[:-1]
        all_boxes = comma.join(text for text, _ in boxes)
        stay = comma.join(text for text, is_ghost in boxes if not is_ghost)
        whole.append(f'{head}, "boxes": [ {all_boxes}], "z": 1e3}}{end}')
        left.append(f'{head}, "boxes": [ {stay}], "z": 1e3}}{end}')
    recording.files["manifest.jsonl"] = "".join(whole).encode()
    recording.left["manifest.jsonl"] = "".join(left).encode()
    return recording


RECORDINGS = {
    "yolo": yolo(),
    "kitti": kitti(),
    "voc": voc(),
    "coco": coco(),
    "manifest": manifest(),
}


def tree(folder):
    """All that is in a folder: files with their bytes, folders with None."""
    paths = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*")}
    return {
        name: path.read_bytes() if path.is_file() else None
        for name, path in paths.items()
    }


@pytest.mark.parametrize("layout", RECORDINGS)
@settings(suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_recording_in_its_own_format_loses_rejected_boxes_and_nothing_else(
    layout, data
):
    recording = data.draw(RECORDINGS[layout])
    with tempfile.TemporaryDirectory() as name:
        source = Path(name, "source")
        write_files(source, COMPANIONS | recording.files)
        (source / "empty").mkdir()
        before = tree(source)
        # A few boxes may look like those of another notation.
        frames = read_source(source, layout, recognise=False)
        box_spans = FORMATS[layout].box_spans
        assert box_spans is not None
        for target, config in (("whole", None), ("filtered", CONFIG)):
            copy = RecordingCopy(source, box_spans)
            for frame, outcome in outcomes(frames, config):
                assert outcome.error is None, outcome.error
                verdicts = [box["verdict"] for box in outcome.decisions or ()]
                copy.add(frame, np.flatnonzero(np.array(verdicts) == "rejected"))
            Path(name, target).mkdir()
            copy.write(Path(name, target))

        assert tree(Path(name, "whole")) == before
        assert tree(Path(name, "filtered")) == before | recording.left
        assert tree(source) == before


@pytest.fixture(scope="module")
def client(server: RunningServer) -> Iterator[Client]:
    with Client(server.url, server.token) as client:
        yield client


def through_the_server(
    client: Client, source: Path, layout: ExportFormat
) -> dict[str, bytes]:
    """The files of an export in the format in which a recording was pushed."""
    frames = read_source(source, layout, recognise=False)
    name = f"same-{uuid4().hex}"
    client.create_dataset(
        name, classes=list(CLASSES), palette="carla-0.9.14", config={"profile": "paper"}
    )
    outcomes = list(client.push(name, outgoing(frames)))
    assert [outcome.word for outcome in outcomes] == ["stored"] * len(outcomes)
    # Parts are folders of some formats, and here of none.
    export = client.start_export(name, layout, split=[1])
    archive = client.download(client.wait_for_export(export), source / "export.zip")
    with zipfile.ZipFile(archive) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


@pytest.mark.parametrize("layout", ["yolo", "kitti", "voc"])
@settings(max_examples=FEW, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_server_gives_label_files_back_without_rejected_boxes(layout, data, client):
    recording = data.draw(RECORDINGS[layout])
    with tempfile.TemporaryDirectory() as name:
        source = write_files(Path(name), recording.files)
        files = through_the_server(client, source, layout)
        frames = list(read_source(source, layout, recognise=False))

    key_lines = map(json.loads, files["frames.jsonl"].splitlines())
    image_of = {row["key"]: Path(row["file"]) for row in key_lines}
    assert image_of.keys() == {frame.key for frame in frames}
    for frame in frames:
        assert frame.origin is not None
        own = frame.origin.file.relative_to(source)
        labels = image_of[frame.key].with_suffix(own.suffix).as_posix()
        written = files[labels.replace(*FOLDERS[layout], 1)]
        left = recording.left[own.as_posix()]
        if b"ISO-8859-1" in left and "ü".encode("latin-1") in left:
            # No text that JSON could carry: it is composed.
            assert written.count(b"<object>") == len(re.findall(b"<bndbox>", left))
        else:
            image = b"<filename>%s</filename>" % image_of[frame.key].name.encode()
            assert written == re.sub(b"<filename>.*?</filename>", image, left)


FOLDERS = {
    "yolo": ("images", "labels"),
    "kitti": ("image_2", "label_2"),
    "voc": ("JPEGImages", "Annotations"),
}


@settings(max_examples=FEW, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_a_server_gives_a_coco_file_back_without_rejected_boxes(data, client):
    recording = data.draw(RECORDINGS["coco"])
    with tempfile.TemporaryDirectory() as name:
        source = write_files(Path(name), recording.files)
        files = through_the_server(client, source, "coco")

    file = "annotations/instances_train.json"
    expected = json.loads(recording.left[file].decode("utf-8-sig"))
    written = json.loads(files[file])
    for image in written["images"]:
        image["file_name"] = unquote(image["file_name"])
        assert image.pop("key") == image["file_name"].rpartition(".")[0]
    for list_name in ("images", "annotations", "categories"):
        for document in (expected, written):
            document[list_name].sort(key=itemgetter("id"))
    assert written == expected


def test_every_format_that_can_be_written_as_it_came_is_drawn():
    able = {name for name, form in FORMATS.items() if form.box_spans}
    assert able - {"carlasimu", "pairs"} == set(RECORDINGS)
