"""An export that is pushed again gives the same labels; options are checked."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

from filter_core.formats.registry import EXPORT_FORMATS, FORMATS
from tests.support import frames as scene
from tests.support.command_line import CommandLine
from tests.support.sensors import ANNOTATION, sensors
from unghost import Client, Invalid

KEYS = ["run/000001", "Run/000001", "straße 7", "v1.2.dots", "empty"]
CLASSES = ["walker", "traffic light", "car"]
READ_AND_WRITTEN = [name for name in EXPORT_FORMATS if FORMATS[name].read]


def fill(client: Client, name: str) -> str:
    """Make a dataset: frames with a kept and a rejected box, and one without boxes."""
    client.create_dataset(name, classes=CLASSES)
    for number, key in enumerate(KEYS):
        annotation = scene.annotation() | {"mine": {"number": number}}
        if key == "empty":
            annotation["boxes"] = []
        client.put_frame(
            name,
            key,
            annotation,
            image=scene.image(number),
            segmentation=scene.segmentation(),
        )
    return name


@pytest.fixture(scope="module")
def filled_dataset(server):
    with Client(server.url, server.token) as client:
        return fill(client, "formats")


def export_and_unpack(
    client: Client, dataset: str, form: str, folder: Path, **options
) -> Path:
    """Export a dataset and unpack the download into `folder`."""
    done = client.wait_for_export(client.start_export(dataset, form, **options))
    archive = client.download(done, folder.with_suffix(".zip"))
    with zipfile.ZipFile(archive) as packed:
        assert packed.testzip() is None
        packed.extractall(folder)
    return folder


def labels(folder: Path) -> dict[str, bytes]:
    """Every file but manifest.json, which says where the labels came from."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in files
        if path.name != "manifest.json"
    }


def test_ids_of_64_bits_come_back_with_all_digits(client, tmp_path):
    name, ids = "long-ids", [2**64 - 1, 2**64 - 2, 2**53 + 1]
    boxes = [{"id": n, "class": "car", "xyxy": scene.ON_THE_CAR} for n in ids]
    client.create_dataset(name)
    client.put_frame(
        name,
        "a",
        scene.annotation() | {"boxes": boxes},
        image=scene.image(),
        segmentation=scene.segmentation(),
    )

    assert {one.id for one in client.boxes(name)} == set(map(str, ids))
    for form in ("manifest", "decisions-jsonl", "decisions-csv", "coco"):
        folder = export_and_unpack(client, name, form, tmp_path / form)
        content = b"".join(labels(folder).values())
        assert all(str(number).encode() in content for number in ids), form


@pytest.mark.parametrize("form", READ_AND_WRITTEN)
def test_export_pushed_again_gives_the_same_labels(
    server, client, filled_dataset, tmp_path, form
):
    first = export_and_unpack(client, filled_dataset, form, tmp_path / "first")
    settings = {"UNGHOST_SERVER": server.url, "UNGHOST_TOKEN": server.token}
    again = client.create_dataset(f"again-{form}", classes=CLASSES).name

    push = CommandLine(tmp_path, settings)("push", first, "--dataset", again)
    second = export_and_unpack(client, again, form, tmp_path / "second")

    assert push.code == 0, push.err
    assert [one.key for one in client.frames(again)] == sorted(KEYS)
    assert labels(second) == labels(first)


def test_kitti_export_applies_bands_and_dontcare_regions(
    client, filled_dataset, tmp_path
):
    folder = export_and_unpack(
        client,
        filled_dataset,
        "kitti",
        tmp_path / "out",
        bands=[50],
        rejected="dontcare",
    )

    for name in ("label_2", "label50"):
        lines = (folder / "training" / name / "000000.txt").read_text().splitlines()
        assert [line.split()[0] for line in lines] == ["car", "DontCare"]


@pytest.mark.parametrize(
    ("form", "options", "pointer"),
    [
        ("nothing", {}, "/format"),
        ("cvat", {"bands": [50]}, "/options/bands"),
        ("yolo", {"bands": [0]}, "/options/bands/0"),
        ("yolo", {"colour": 1}, "/options/colour"),
    ],
)
def test_unknown_format_or_invalid_option_raises_invalid(
    client, filled_dataset, form, options, pointer
):
    with pytest.raises(Invalid) as caught:
        client.start_export(filled_dataset, form, **options)

    assert caught.value.status == 422
    assert pointer in str(caught.value.errors)


def test_tight_rectangles_are_exported_as_labels(client, tmp_path):
    name = client.create_dataset("tight", classes=["car"]).name
    client.put_frame(name, "a", ANNOTATION, **sensors())
    client.wait(client.evaluate(name))
    # Nothing of the box behind is visible, so its rectangle stays as it is.
    options = {"boxes": "tight", "allow_missing_images": True}
    coco = export_and_unpack(client, name, "coco", tmp_path / "coco", **options)
    yolo = export_and_unpack(client, name, "yolo", tmp_path / "yolo", **options)

    tight = [61.0, 41.0, 38.0, 38.0]
    found = [
        one["bbox"]
        for path in coco.rglob("annotations/*.json")
        for one in json.loads(path.read_text("utf-8"))["annotations"]
    ]
    assert tight in found
    x, y, width, height = tight
    label = [(x + width / 2) / 160, (y + height / 2) / 120, width / 160, height / 120]
    (text,) = [path.read_text() for path in yolo.rglob("labels/**/*.txt")]
    lines = [[float(word) for word in line.split()[1:]] for line in text.splitlines()]
    assert any(line == pytest.approx(label, abs=1e-6) for line in lines)
    manifest = json.loads((coco / "manifest.json").read_text("utf-8"))
    assert manifest["counts"]["rectangles"] == {"tight": 1, "visible": 1}
