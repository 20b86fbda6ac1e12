"""Reading a folder that a person drops on the page: nothing of it is stored."""

from __future__ import annotations

import io
import json
import os
import re
import tarfile
import threading

import cv2
import numpy as np
import pytest

from app.ingest.folder import TEXT_SUFFIXES
from filter_core.formats.registry import FORMATS, LAYOUTS, read_source
from tests.support.api import BASE
from tests.support.archives import END, header_of, lines_of
from tests.support.sources import CHECKOUT
from tests.support.waiting import until

TAR = {"Content-Type": "application/x-tar"}
LINE = b"0 0.5 0.5 0.1 0.2\n"
BOX = {"class": "car", "cxcywhn": [0.5, 0.5, 0.1, 0.2]}
PICTURE = cv2.imencode(".png", np.zeros((60, 80, 3), np.uint8))[1].tobytes()
VOC = b"""<annotation><object><name>car</name><bndbox><xmin>1</xmin><ymin>2</ymin>
<xmax>10</xmax><ymax>20</ymax></bndbox></object></annotation>"""
COCO = {
    "images": [{"id": 1, "file_name": "7.png", "width": 80, "height": 60}],
    "annotations": [{"id": 5, "image_id": 1, "category_id": 2, "bbox": [1, 2, 3, 4]}],
    "categories": [{"id": 2, "name": "car"}],
}
KITTI = b"Car 0.5 1 -1.57 10 20 30 40 1.5 1.6 4 1 2 20 0.1\n"
P2 = b"P2: 40 0 40 0 0 40 30 0 0 0 1 0\n"
MANIFEST = b'{"key": "a/0", "image": "rgb/0.png", "depth": "d.npy", "boxes": []}\n'
FOLDERS = {
    "yolo": {
        "data.yaml": b"names: [car]",
        "images/train/1.png": b"",
        "labels/train/1.txt": LINE,
        "seg/1.png": b"",
    },
    "carlasimu": {
        "images/1.png": b"",
        "labels/label50/1.txt": b"",
        "labels/label200/1.txt": b"4 .5 .5 .1 .2",
        "seg/1.png": b"",
    },
    "voc": {"Annotations/1.xml": VOC, "JPEGImages/1.jpg": b""},
    "kitti": {
        "training/label_2/000000.txt": KITTI,
        "training/image_2/000000.png": PICTURE[:24],
        "training/calib/000000.txt": P2,
    },
    "coco": {
        "annotations/instances_val.json": json.dumps(COCO).encode(),
        "images/7.png": b"",
    },
    "manifest": {"manifest.jsonl": MANIFEST, "rgb/0.png": b"", "d.npy": b""},
    "pairs": {
        "1.png": b"",
        "1_seg.png": b"",
        "1.json": json.dumps({"boxes": [BOX]}).encode(),
    },
}


def archive(files):
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w", format=tarfile.GNU_FORMAT) as packing:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            packing.addfile(member, io.BytesIO(content))
    return out.getvalue()


def post_folder(client, content, headers=TAR, **parameters):
    content = archive(content) if isinstance(content, dict) else content
    path = f"{BASE}/folders"
    return client.post(path, content=content, headers=headers, params=parameters)


def parse_response(answer):
    """The parts of an answer: first line, frames by key, unmatched files, last line."""
    assert answer.status_code == 200, answer.text
    head, *lines, end = lines_of(answer.text)
    frames = {line["key"]: line for line in lines if "key" in line}
    unmatched = {line["path"]: line["why"] for line in lines if "path" in line}
    assert (end["frames"], end["unmatched"]) == (len(frames), len(unmatched))
    assert end["faulty"] == sum(line["fault"] is not None for line in frames.values())
    return head, frames, unmatched, end


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_every_layout_is_read_as_the_library_reads_it(admin, tmp_path, layout):
    for name, content in FOLDERS[layout].items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)

    head, frames, unmatched, _ = parse_response(post_folder(admin, FOLDERS[layout]))

    here = read_source(tmp_path)
    assert head == {
        "layout": layout,
        "layouts": [layout],
        "titles": {layout: FORMATS[layout].title},
        "classes": None if here.classes is None else list(here.classes),
        "count": here.count,
    }
    assert unmatched == {one.path: one.why for one in here.unmatched}
    (frame,) = frames.values()
    (expected,) = here
    paths = {"image": expected.image, "segmentation": expected.segmentation}
    files = {kind: path for kind, path in {**paths, **expected.others}.items() if path}
    assert frame == {
        "key": expected.key,
        "annotation": expected.annotation,
        "files": {
            kind: path.relative_to(tmp_path).as_posix() for kind, path in files.items()
        },
        "fault": None,
    }
    assert frame["annotation"] is not None
    assert frame["files"]


PAGE = (CHECKOUT / "static/js/upload/folder.js").read_text("utf-8")


def page_pattern(name):
    """A regular expression of the page; Python reads these in the same way."""
    (found,) = re.findall(rf"^const {name} = /(.+)/(i?);", PAGE, re.MULTILINE)
    pattern, flag = found
    return re.compile(pattern.replace(r"\/", "/"), re.IGNORECASE if flag else 0)


def part_sent_by_the_page(name, content):
    if page_pattern("TEXT").search(name):
        return content
    return content[:24] if page_pattern("SIZED").search(name) else b""


def read_as(layout, folder, files):
    """What the library finds in these files once they are written to the folder."""
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    found = read_source(folder, layout)
    frames = [(one.key, one.annotation, one.problem) for one in found]
    return found.classes, found.count, found.unmatched, frames


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_page_sends_the_content_that_the_reader_of_each_layout_needs(tmp_path, layout):
    files = {
        name: PICTURE if name.endswith((".png", ".jpg")) else content
        for name, content in FOLDERS[layout].items()
    }
    sent = {name: part_sent_by_the_page(name, files[name]) for name in files}

    assert read_as(layout, tmp_path / "sent", sent) == read_as(
        layout, tmp_path / "whole", files
    )


def test_page_sends_the_content_of_every_text_that_the_service_knows():
    sent = page_pattern("TEXT")

    assert [end for end in TEXT_SUFFIXES if not sent.search(f"a{end}")] == []


def test_image_size_is_read_from_its_first_bytes(admin):
    _, frames, _, _ = parse_response(post_folder(admin, FOLDERS["kitti"]))

    camera = frames["000000"]["annotation"]["camera"]
    assert (camera["width"], camera["height"]) == (80, 60)


def test_faulty_and_unmatched_files_are_listed_beside_valid_frames(admin):
    files = {
        "town/data.yaml": b"names: [car, van]",
        "town/images/1.png": b"",
        "town/labels/1.txt": LINE,
        "town/labels/2.txt": b"9 1 1 1 1",
        "town/images/stray.png": b"",
        "town/README.md": b"",
        "town/.DS_Store": b"",
        "__MACOSX/town/._1.txt": b"",
    }

    head, frames, unmatched, end = parse_response(post_folder(admin, files))

    assert (head["layout"], head["classes"]) == ("yolo", ["car", "van"])
    assert frames["1"]["annotation"] == {"boxes": [BOX]}
    assert frames["1"]["files"] == {"image": "town/images/1.png"}
    assert frames["2"] == {
        "key": "2",
        "annotation": None,
        "files": {},
        "fault": {
            "pointer": "",
            "code": "bad_layout",
            "detail": "labels/2.txt, line 1: expected a class from 0 to 1, found '9'",
        },
    }
    assert unmatched == {
        "images/stray.png": "no label file for this image",
        "README.md": "neither an image nor a label",
    }
    assert end == {"end": True, "frames": 2, "faulty": 1, "unmatched": 2}


def test_file_named_by_a_manifest_but_missing_is_a_fault(admin):
    lines = [
        {"key": "a", "image": "./rgb/a.png"},
        {"key": "windows", "image": "rgb\\a.png"},
        {"key": "b", "image": "rgb/b.png"},
        {"key": "out", "segmentation": "../../a.png"},
        {"key": "absolute", "image": "/etc/passwd"},
    ]
    text = "\n".join(map(json.dumps, lines)) + '\n{"key": "inf", "extra": 1e999}'
    files = {"manifest.jsonl": text.encode(), "rgb/a.png": b"", "rgb/z.png": b""}

    _, frames, unmatched, _ = parse_response(post_folder(admin, files))

    faults = {key: frame["fault"] for key, frame in frames.items()}
    assert faults.pop("a") is faults.pop("windows") is None
    assert {key: fault["detail"] for key, fault in faults.items()} == {
        "b": "image: rgb/b.png is not among these files",
        "out": "segmentation: ../../a.png is not among these files",
        "absolute": "image: /etc/passwd is not among these files",
        "inf": "a number in the annotation is too large",
    }
    assert unmatched == {"rgb/z.png": "no line of the manifest names it"}


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../outside.txt", "out of the folder"),
        ("/etc/outside.txt", "out of the folder"),
        ("labels/../../outside.txt", "out of the folder"),
        ("labels//outside.txt", "out of the folder"),
        ("labels/con.txt", "a device"),
        ("labels/LPT1", "a device"),
        ("labels/" + "x" * 256, "too long"),
        ("/".join(["x" * 250] * 5), "too long"),
        ("/".join("x" * 40), "too deep"),
        ("labels/1.txt", "another file has this name"),
        ("labels/1.txt/2.txt", "another file has this name"),
        ("labels/a\nb: *?.md", "neither an image nor a label"),
    ],
)
def test_unsafe_or_invalid_file_names_are_unmatched_and_not_written(
    admin, service, name, why
):
    files = {"labels/1.txt": LINE, "data.yaml": b"names: [car]"}
    content = pieces(files) + pieces({name: b"outside"}) + END

    _, frames, unmatched, _ = parse_response(post_folder(admin, content))

    assert [*frames] == ["1"]
    assert why in unmatched[name]
    around = os.walk(service.app.state.settings.data.parent)
    assert [file for *_, files in around for file in files if "outside" in file] == []


def pieces(files):
    """The members of an archive without its end: joined, they can repeat a name."""
    members = []
    for name, content in files.items():
        member = tarfile.TarInfo(name)
        member.size = len(content)
        head = member.tobuf(tarfile.GNU_FORMAT)
        members.append(head + content + bytes(-len(content) % 512))
    return b"".join(members)


def wait_until_files_are_removed(data):
    """Wait until the files that were sent are removed, which is after the answer."""
    until(lambda: not any("folder-" in folder for folder, *_ in os.walk(data)))


def test_reading_a_folder_stores_nothing_and_removes_its_files(serve, tmp_path):
    with serve().admin() as admin:
        parse_response(post_folder(admin, FOLDERS["yolo"]))
        assert post_folder(admin, {"notes.md": b""}).status_code == 422
        assert post_folder(admin, archive(FOLDERS["yolo"])[:700]).status_code == 422

        assert admin.get(f"{BASE}/datasets").json()["items"] == []
        wait_until_files_are_removed(tmp_path)


def test_several_layouts_are_listed_and_one_can_be_chosen(admin):
    files = {"a.xml": VOC, "a.txt": LINE, "classes.txt": b"car", "a.png": b""}

    first, *_ = parse_response(post_folder(admin, files))
    second, frames, *_ = parse_response(post_folder(admin, files, layout="yolo"))

    assert (first["layout"], first["layouts"]) == ("voc", ["voc", "yolo"])
    assert (second["layout"], second["layouts"]) == ("yolo", ["voc", "yolo"])
    assert second["titles"] == {"voc": "Pascal VOC", "yolo": "YOLO (Ultralytics)"}
    assert frames["a"]["annotation"] == {"boxes": [BOX]}


def test_images_with_unreadable_labels_need_an_explicit_layout(admin):
    files = {"images/1.png": b"", "labels/1.txt": LINE}

    refused = post_folder(admin, files)
    _, frames, unmatched, _ = parse_response(post_folder(admin, files, layout="pairs"))

    assert (refused.status_code, refused.json()["code"]) == (422, "bad_layout")
    assert "these files: no layout recognised; expected" in refused.json()["detail"]
    assert [*frames] == ["1"]
    assert "another layout" in unmatched["labels/1.txt"]


@pytest.mark.parametrize(
    ("content", "headers", "layout", "status"),
    [
        (b"no archive" * 100, TAR, "auto", 422),
        (b"", TAR, "auto", 422),
        (header_of("a", 0, tarfile.SYMTYPE) + END, TAR, "auto", 422),
        (b"\x1f\x8b" + bytes(600), TAR, "auto", 415),
        (END, {"Content-Type": "application/zip"}, "auto", 415),
        (END, TAR, "ylo", 422),
        (END, {**TAR, "Idempotency-Key": "no spaces"}, "auto", 400),
    ],
)
def test_body_that_is_not_a_folder_archive_is_refused(
    admin, content, headers, layout, status
):
    answer = post_folder(admin, content, headers, layout=layout)

    assert answer.status_code == status, answer.text


def test_xml_with_entities_is_a_fault_of_its_frame(admin):
    bomb = b'<!DOCTYPE a [<!ENTITY b "bb">]><annotation>&b;</annotation>'

    _, frames, _, _ = parse_response(post_folder(admin, {"a.xml": bomb, "b.xml": VOC}))

    assert "a DTD or entities is refused" in frames["a"]["fault"]["detail"]
    assert frames["b"]["fault"] is None


def test_folder_over_the_time_limit_is_refused(serve, tmp_path):
    with serve(max_folder_seconds=0.001).admin() as admin:
        answer = post_folder(admin, FOLDERS["yolo"])

        assert (answer.status_code, answer.json()["code"]) == (422, "pixels_refused")
        assert "UNGHOST_MAX_FOLDER_SECONDS" in answer.json()["detail"]
        wait_until_files_are_removed(tmp_path)


def test_too_large_file_is_unmatched_and_too_large_answer_refused(serve):
    """A label of eight bytes becomes a box of about eighty bytes in the answer."""
    with serve(max_folder_bytes=20_480, max_part_bytes=16_000).admin() as admin:
        large = {"1.txt": bytes(16_001), "2.txt": LINE, "classes.txt": b"car"}
        _, frames, unmatched, _ = parse_response(
            post_folder(admin, pieces(large) + END)
        )
        many = {"c/label/1.txt": b"0 0 0 0\n" * 1900}
        answer = post_folder(admin, pieces(many) + END)

    assert ([*frames], unmatched) == (["2"], {"1.txt": "larger than 16000 bytes"})
    assert answer.status_code == 422
    assert "is larger than 81920 bytes" in answer.json()["detail"]


def test_folder_upload_counts_as_an_open_batch(serve):
    service = serve(max_open_batches_per_token=1)
    let_go = threading.Event()

    def slow():
        yield archive(FOLDERS["yolo"])[:512]
        let_go.wait(60)
        yield archive(FOLDERS["yolo"])[512:]

    answers = []
    with service.admin() as sender, service.admin() as admin:
        sending = threading.Thread(
            target=lambda: answers.append(post_folder(sender, slow()))
        )
        sending.start()
        while "unghost_batches_open 1" not in admin.get("/metrics").text:
            assert sending.is_alive()
        refused = post_folder(admin, FOLDERS["yolo"])
        let_go.set()
        sending.join()

    assert (refused.status_code, refused.json()["code"]) == (429, "too_many_requests")
    assert parse_response(answers[0])[1]["train/1"]["fault"] is None


def test_reading_a_folder_needs_the_role_reviewer(as_role):
    assert post_folder(as_role("viewer"), FOLDERS["yolo"]).status_code == 403
    assert post_folder(as_role("reviewer"), FOLDERS["yolo"]).status_code == 200
