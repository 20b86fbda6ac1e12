"""Reading a folder that a person drops on the page: nothing of it is stored."""

import base64
import json
import os
import tarfile
import threading

import numpy as np
import pytest
import yaml

from filter_core.formats.recording import LAYOUTS
from filter_core.formats.registry import FORMATS, read_source
from filter_core.formats.same import with_labels
from filter_core.inspection.recording import inspect_recording
from filter_core.inspection.remarks import by_role
from tests.support.api import BASE
from tests.support.archives import (
    END,
    TAR,
    header_of,
    lines_of,
    tar_archive,
    tar_without_end,
)
from tests.support.folders import (
    BOX,
    LAYOUT_FILES,
    VOC_FILE,
    YOLO_LINE,
    mixed_recording,
    street_tags,
    write_files,
)
from tests.support.pictures import png
from tests.support.waiting import until


def archive(files):
    return tar_archive(files.items(), tarfile.GNU_FORMAT)


def post_folder(client, content, headers=TAR, **parameters):
    content = archive(content) if isinstance(content, dict) else content
    path = f"{BASE}/folders"
    return client.post(path, content=content, headers=headers, params=parameters)


def parse_response(response):
    """The parts of an answer: first line, frames by key, unmatched files, last line."""
    assert response.status_code == 200, response.text
    head, *lines, end = lines_of(response.text)
    frames = {line["key"]: line for line in lines if "key" in line}
    unmatched = {line["path"]: line["why"] for line in lines if "path" in line}
    assert (end["frames"], end["unmatched"]) == (len(frames), len(unmatched))
    assert end["faulty"] == sum(line["fault"] is not None for line in frames.values())
    return head, frames, unmatched, end


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_every_layout_is_read_as_the_library_reads_it(admin, tmp_path, layout):
    write_files(tmp_path, LAYOUT_FILES[layout])

    head, frames, unmatched, _ = parse_response(
        post_folder(admin, LAYOUT_FILES[layout])
    )

    here = read_source(tmp_path)
    assert head == {
        "layout": layout,
        "layouts": [layout],
        "titles": {layout: FORMATS[layout].title},
        "classes": None if here.classes is None else list(here.classes),
        "settings": {},
        "config": {},
        "count": here.count,
    }
    assert unmatched == {file.path: file.why for file in here.unmatched}
    (frame,) = frames.values()
    (expected,) = here
    paths = {"image": expected.image, "segmentation": expected.segmentation}
    files = {kind: path for kind, path in {**paths, **expected.others}.items() if path}
    assert frame == {
        "key": expected.key,
        "annotation": with_labels(expected, layout),
        "annotation_text": None,
        "files": {
            kind: path.relative_to(tmp_path).as_posix() for kind, path in files.items()
        },
        "fault": None,
    }
    assert frame["annotation"] is not None
    assert frame["files"]


def test_description_of_a_recording_is_carried_out_and_told(admin):
    text = b"""
segmentation: {folder: tags, palette: carla-0.9.14, tags: {100: Car}, scale: 2}
boxes: {classes: [Auto]}
classes: {Auto: car}
"""
    files = {"a/1.png": b"", "a/1.txt": b"0 .5 .5 .5 .5", "tags/1.png": b""}
    wrong = {"1.png": b"", "recording.yaml": b"segmentation: {folder: ..}"}

    head, frames, unmatched, _ = parse_response(
        post_folder(admin, {**files, "recording.yaml": text}, layout="yolo")
    )
    refused = post_folder(admin, wrong)

    assert (head["classes"], unmatched) == (["Auto"], {})
    assert head["settings"] == {"palette": "carla-0.9.14"}
    changed = {"tags": {"100": "Car"}, "tag_scale": 2}
    assert head["config"] == {**changed, "classes": {"Auto": "car"}}
    # As the page does.
    dataset = {"name": "described", "config": head["config"]}
    assert admin.post(f"{BASE}/datasets", json=dataset).status_code == 201
    (frame,) = frames.values()
    assert frame["files"] == {"image": "a/1.png", "segmentation": "tags/1.png"}
    assert "segmentation.folder: expected a folder in that of" in refused.text


def test_digits_that_javascript_would_lose_come_as_text_too(admin):
    boxes = [{"id": 2**64 - 1, "class": "car", "xyxy": [1, 2, 3.5, 4]}]
    lines = [{"key": "a", "boxes": boxes}, {"key": "b", "boxes": [BOX], "at": 1.5}]
    content = "\n".join(map(json.dumps, lines)).encode()

    _, frames, _, _ = parse_response(post_folder(admin, {"manifest.jsonl": content}))

    assert json.loads(frames["a"]["annotation_text"]) == {"boxes": boxes}
    assert frames["b"]["annotation_text"] is None


@pytest.mark.parametrize(
    ("names", "has_note"),
    [
        (("front/1.png", "gt/1.png"), True),
        (("1.png", "1_gt.png"), True),
        (("rgb/1.png", "gt/1.png"), True),
        (("1.png", "2.png"), False),
        (("rgb/1.png", "seg/1.png"), False),
    ],
)
def test_last_line_says_where_names_alone_told_pictures(admin, names, has_note):
    response = post_folder(admin, dict.fromkeys(names, b""))

    *_, end = parse_response(response)

    assert [("told pictures from segmentations" in note) for note in end["notes"]] == (
        [True] if has_note else []
    )


@pytest.mark.parametrize(
    "files",
    [
        LAYOUT_FILES["kitti"],
        {
            "image_2/000000.png": b"",
            "boxes/000000.json": b'[{"class": "car", "location": [20, 0, 1],'
            b' "extent": [2, 1, 1], "rotation": [0, 0, 0]}]',
            "recording.yaml": b"files: {image: 'image_2/{frame}.png', labels: "
            b"'boxes/{frame}.json'}\ncameras: {fov: 90, pose: {location: [0, 0, 1], "
            b"rotation: [0, 0, 0]}}",
        },
    ],
)
def test_camera_has_the_size_of_images_beside_those_that_were_not_sent(admin, files):
    second = {name.replace("0.", "1."): content for name, content in files.items()}
    picture = next(name for name in files if "image_2" in name)
    both = {**second, **files, picture: png(np.zeros((60, 80, 3), np.uint8))}
    both[picture.replace("0.", "1.")] = b""

    _, frames, _, end = parse_response(post_folder(admin, both))

    assert [frames[key]["fault"] for key in ("000000", "000001")] == [None, None]
    camera = frames["000001"]["annotation"]["camera"]
    assert (camera["width"], camera["height"]) == (80, 60)
    (note,) = [note for note in end["notes"] if "are taken to have the size" in note]
    assert "80 x 60 px" in note
    assert note in str(end["inspection"]["remarks"])


def test_faulty_and_unmatched_files_are_listed_beside_valid_frames(admin):
    files = {
        "town/data.yaml": b"names: [car, van]",
        "town/images/1.png": b"",
        "town/labels/1.txt": YOLO_LINE,
        "town/labels/2.txt": b"9 1 1 1 1",
        "town/images/stray.png": b"",
        "town/README.md": b"",
        "town/.DS_Store": b"",
        "__MACOSX/town/._1.txt": b"",
    }

    head, frames, unmatched, end = parse_response(post_folder(admin, files))

    assert (head["layout"], head["classes"]) == ("yolo", ["car", "van"])
    assert frames["1"]["annotation"]["boxes"] == [BOX]
    assert frames["1"]["files"] == {"image": "town/images/1.png"}
    assert frames["2"] == {
        "key": "2",
        "annotation": None,
        "annotation_text": None,
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
    counts = {"end": True, "frames": 2, "faulty": 1, "unmatched": 2, "notes": []}
    assert end == {**counts, "inspection": end["inspection"]}
    read_with = end["inspection"]["read_with"]
    assert read_with["companions"] == {".": 2, "images": 1}


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
        "inf": "expected finite numbers in the annotation, found one that is NaN or "
        "too large",
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
    files = [("labels/1.txt", YOLO_LINE), ("data.yaml", b"names: [car]")]
    content = tar_without_end([*files, (name, b"outside")]) + END

    _, frames, unmatched, _ = parse_response(post_folder(admin, content))

    assert [*frames] == ["1"]
    assert why in unmatched[name]
    around = os.walk(service.app.state.settings.data.parent)
    assert [file for *_, files in around for file in files if "outside" in file] == []


def wait_until_files_are_removed(data):
    """Wait until the files that were sent are removed, which is after the answer."""
    until(lambda: not any("folder-" in folder for folder, *_ in os.walk(data)))


def test_reading_a_folder_stores_nothing_and_removes_its_files(serve, tmp_path):
    with serve().admin() as admin:
        parse_response(post_folder(admin, LAYOUT_FILES["yolo"]))
        wrong = {"notes.md": b"", "recording.yaml": b"layout: ylo"}
        assert post_folder(admin, wrong).status_code == 422
        assert (
            post_folder(admin, archive(LAYOUT_FILES["yolo"])[:700]).status_code == 422
        )

        assert admin.get(f"{BASE}/datasets").json()["items"] == []
        wait_until_files_are_removed(tmp_path)


def test_several_layouts_are_listed_and_one_can_be_chosen(admin):
    files = {"a.xml": VOC_FILE, "a.txt": YOLO_LINE, "classes.txt": b"car", "a.png": b""}

    first, *_, end = parse_response(post_folder(admin, files))
    second, frames, *_ = parse_response(post_folder(admin, files, layout="yolo"))

    assert (first["layout"], first["layouts"]) == ("voc", ["voc", "yolo"])
    assert (second["layout"], second["layouts"]) == ("yolo", ["voc", "yolo"])
    assert second["titles"] == {"voc": "Pascal VOC", "yolo": "YOLO (Ultralytics)"}
    (remark,) = (
        note for note in end["inspection"]["remarks"] if "could be" in note["text"]
    )
    assert remark["finding"].endswith("could be voc or yolo, and are read as voc")
    remedies = [{"place": ["layout"], "value": name} for name in ("voc", "yolo")]
    assert remark["remedies"] == remedies
    assert frames["a"]["annotation"]["boxes"] == [BOX]


def test_folder_that_cannot_be_read_says_what_helps(admin):
    files = {"images/1.png": b"", "labels/1.txt": YOLO_LINE}

    head, frames, _, end = parse_response(post_folder(admin, files))
    _, pairs, unmatched, _ = parse_response(post_folder(admin, files, layout="pairs"))
    described = {**files, "recording.yaml": json.dumps(DESCRIPTION).encode()}
    _, read, _, last = parse_response(post_folder(admin, described))

    assert (head["layout"], frames) == (None, {})
    (remark,) = end["inspection"]["remarks"]
    assert remark["text"].startswith("these files: no layout recognised; expected")
    assert remark["text"].endswith(
        "`layout: yolo` and `boxes: {classes: [car, bus]}` in recording.yaml name them "
        "in their order"
    )
    assert remark["is_serious"]
    assert [*pairs] == ["1"]
    assert "another layout" in unmatched["labels/1.txt"]
    assert read["1"]["annotation"]["boxes"] == [BOX]
    assert last["inspection"]["given"] == DESCRIPTION


DESCRIPTION = {"layout": "yolo", "boxes": {"classes": ["car"]}}


def test_unit_is_recognised_by_the_images_that_were_sent_whole(admin):
    rows = "".join(f"{n}.png,car,{n}.5,20.5,{n + 40}.5,80.5\n" for n in range(1, 8))
    files = {f"{number}.png": b"" for number in range(1, 8)}
    files["3.png"] = png(np.zeros((400, 500, 3), np.uint8))
    files["boxes.csv"] = f"image,label,x1,y1,x2,y2\n{rows}".encode()

    _, frames, _, _ = parse_response(post_folder(admin, files))

    assert {frame["fault"]["code"] for frame in frames.values()} == {"wrong_unit"}


def test_folder_is_inspected_by_those_of_its_images_that_were_sent_whole(
    admin, tmp_path
):
    root = mixed_recording(tmp_path / "street")
    whole = {"train/images/005.png", "train/seg/005.png", "test/images/002.png"}
    bare = [path for path in root.rglob("*.png") if name_in(root, path) not in whole]
    files = {
        f"street/{name_in(root, path)}": b"" if path in bare else path.read_bytes()
        for path in root.rglob("*.*")
    }
    files |= {"street/train/seg/006.png": (root / "train/seg/006.png").read_bytes()}

    _, frames, _, end = parse_response(post_folder(admin, files))

    assert {
        frame["fault"] and frame["fault"]["detail"] for frame in frames.values()
    } == {None}
    here, told = inspect_recording(root), end["inspection"]
    assert (told["looked_at"], told["why"]) == (1, here.why)
    picture = told["streams"][0]
    assert picture["pattern"] == "{part}/images/{frame}.png"
    assert picture["example"] in files
    assert [(stream["role"], stream["images"]) for stream in told["streams"]] == [
        (stream.role, stream.images) for stream in by_role(here)
    ]
    names = ("name", "boxes", "measured_as", "nearest", "tags")
    assert [[row[key] for key in names] for row in told["classes"]] == [
        [row.name, row.boxes, row.measured_as, row.nearest, [*row.tags]]
        for row in here.classes
    ]
    counts = [
        (row["kept"], row["rejected"], row["unmeasured"]) for row in told["classes"]
    ]
    assert counts == [(2, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 1), (0, 0, 0)]
    (painted,) = told["painted"]
    assert (painted["key"], painted["width"], painted["height"]) == (
        *("train/005", 320, 180),
    )
    assert base64.b64decode(painted["jpeg"])[:3] == b"\xff\xd8\xff"
    assert painted["boxes"][0]["verdict"] == "kept"
    texts = [note["text"] for note in told["remarks"]]
    assert any("`classes: {Caar: car}`" in text for text in texts)
    assert not any("--" in text for text in texts)
    assert told["given"] == {"segmentation": {"palette": "carla-0.9.14"}}
    assert yaml.safe_load(told["recording"])["layout"] == "yolo"


def name_in(root, path):
    return path.relative_to(root).as_posix()


@pytest.mark.parametrize("sent", ["gt/07.png", "gt/11.png"])
def test_role_of_a_stream_is_told_by_any_image_that_was_sent_whole(admin, sent):
    names = [
        f"{folder}/{number:02}.png" for folder in ("rgb", "gt") for number in range(12)
    ]
    files = {**dict.fromkeys(names, b""), sent: png(street_tags())}

    *_, end = parse_response(post_folder(admin, files))

    roles = {stream["role"]: stream for stream in end["inspection"]["streams"]}
    assert (roles["segmentation"]["images"], roles["image"]["images"]) == (12, 12)
    assert roles["segmentation"]["told_by"] == ["pixels"]
    assert end["notes"] == []


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
    response = post_folder(admin, content, headers, layout=layout)

    assert response.status_code == status, response.text


def test_xml_with_entities_is_a_fault_of_its_frame(admin):
    bomb = b'<!DOCTYPE a [<!ENTITY b "bb">]><annotation>&b;</annotation>'

    _, frames, _, _ = parse_response(
        post_folder(admin, {"a.xml": bomb, "b.xml": VOC_FILE, "b.png": b""})
    )

    assert "a DTD or entities is refused" in frames["a"]["fault"]["detail"]
    assert frames["b"]["fault"] is None


def test_damaged_pictures_are_said_and_stop_nothing(admin):
    picture = png(np.zeros((60, 80, 3), np.uint8))
    header = picture[:16] + b"\x7f\xff\xff\xff" * 2 + picture[24:]
    files = {"classes.txt": b"car", "a.txt": YOLO_LINE, "b.txt": YOLO_LINE}
    files |= {"a.png": b"no picture at all", "b.png": header}

    _, frames, _, end = parse_response(post_folder(admin, files))

    assert [frame["fault"] for frame in frames.values()] == [None, None]
    said = [note["text"] for note in end["inspection"]["remarks"] if note["is_serious"]]
    (pictures,) = (text for text in said if "that were looked at" in text)
    assert pictures.startswith(
        "2 of 2 frames that were looked at cannot be used (bad_image), such as a: "
    )


def test_folder_over_the_time_limit_is_refused(serve, tmp_path):
    labels = {f"labels/train/{number}.txt": YOLO_LINE for number in range(2000)}
    with serve(max_folder_seconds=0.001).admin() as admin:
        response = post_folder(admin, {**LAYOUT_FILES["yolo"], **labels})

        assert (response.status_code, response.json()["code"]) == (
            422,
            "pixels_refused",
        )
        assert "UNGHOST_MAX_FOLDER_SECONDS" in response.json()["detail"]
        wait_until_files_are_removed(tmp_path)


def test_too_large_file_is_unmatched_and_too_large_answer_refused(serve):
    """A label of eight bytes becomes a box of about eighty bytes in the answer."""
    with serve(max_folder_bytes=20_480, max_part_bytes=16_000).admin() as admin:
        large = {"1.txt": bytes(16_001), "2.txt": YOLO_LINE, "classes.txt": b"car"}
        _, frames, unmatched, _ = parse_response(post_folder(admin, large))
        many = {"c/label/1.txt": b"0 0 0 0\n" * 1900, "c/img/1.png": b""}
        response = post_folder(admin, many)

    assert ([*frames], unmatched) == (["2"], {"1.txt": "larger than 16000 bytes"})
    assert response.status_code == 422
    assert "is larger than 81920 bytes" in response.json()["detail"]


def test_folder_upload_counts_as_an_open_batch(serve):
    service = serve(max_open_batches=1)
    let_go = threading.Event()

    def slow():
        yield archive(LAYOUT_FILES["yolo"])[:512]
        let_go.wait(60)
        yield archive(LAYOUT_FILES["yolo"])[512:]

    responses = []
    with service.admin() as sender, service.admin() as admin:
        sending = threading.Thread(
            target=lambda: responses.append(post_folder(sender, slow()))
        )

        def is_open():
            assert sending.is_alive()
            return "unghost_batches_open 1" in admin.get("/metrics").text

        sending.start()
        until(is_open)
        refused = post_folder(admin, LAYOUT_FILES["yolo"])
        let_go.set()
        sending.join()

    assert (refused.status_code, refused.json()["code"]) == (429, "too_many_requests")
    assert parse_response(responses[0])[1]["train/1"]["fault"] is None
