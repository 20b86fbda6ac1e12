"""Versions: exports with a name and a digest, kept, and what changed since one."""

import io
import json
import zipfile

import pytest

from tests.support import frames
from tests.support.command_line import CommandLine
from tests.support.waiting import until
from unghost import Client, Conflict, NotFound

NAME = "versions"


@pytest.fixture
def client(service):
    with service.client() as http, Client(str(http.base_url), service.token) as client:
        yield client


@pytest.fixture
def dataset(client, request):
    name = f"versions-{abs(hash(request.node.name)) % 10**8}"
    client.create_dataset(name, classes=["car"])
    for number in range(3):
        frames.put(client, name, f"run/{number}", number)
    return name


def made(client, dataset, name=None, since=None, form="decisions-jsonl"):
    started = client.start_export(dataset, form, name=name, since=since)
    return client.wait_for_export(started)


def files_of(client, export, tmp_path):
    path = client.download(export, tmp_path / f"{export.id}.zip")
    with zipfile.ZipFile(path) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


def keys_of(files):
    return [json.loads(line)["key"] for line in files["decisions.jsonl"].splitlines()]


def test_digest_is_that_of_frames_configuration_and_answers(client, dataset):
    first, same = made(client, dataset), made(client, dataset, form="coco")
    box = next(client.boxes(dataset))
    client.review(box.box_id, "reject", seen_revision=0)
    answered = made(client, dataset)
    client.undo_review(box.box_id, 1)
    undone = made(client, dataset)
    client.wait(client.set_config(dataset, {"threshold_small_box": 99.5}))
    decided = made(client, dataset)
    frames.put(client, dataset, "run/9", 9)
    longer = made(client, dataset)

    assert first.version == same.version == undone.version
    others = {answered.version, decided.version, longer.version}
    assert len({first.version, *others}) == 4
    assert (first.name, first.since) == (None, None)


def test_only_what_changed_since_a_version_is_written(client, dataset, tmp_path):
    first = made(client, dataset, "v1")
    nothing = files_of(client, made(client, dataset, since="v1"), tmp_path)
    box = next(client.boxes(dataset, frame="run/1"))
    client.review(box.box_id, "reject", seen_revision=0)
    client.delete_frame(dataset, "run/0")
    frames.put(client, dataset, "run/9", 9)
    second = made(client, dataset, "v2", since="v1")
    changed = files_of(client, second, tmp_path)
    manifest = json.loads(changed["manifest.json"])

    assert keys_of(nothing) == []
    assert keys_of(changed) == ["run/1", "run/9"]
    assert (manifest["since"], manifest["removed"]) == ("v1", ["run/0"])
    assert second.version == made(client, dataset).version != first.version
    assert [version.name for version in client.versions(dataset)] == ["v2", "v1"]


def test_version_is_written_again_byte_for_byte_when_the_dataset_has_changed(
    client, service, dataset, tmp_path
):
    version = made(client, dataset, "v1", form="decisions-csv")
    before = client.download(version, tmp_path / "before.zip").read_bytes()
    client.delete_frame(dataset, "run/0")
    settings = {"UNGHOST_SERVER": client.url, "UNGHOST_TOKEN": service.token}
    unghost = CommandLine(tmp_path, settings)
    again = unghost("export", dataset, "--version", "v1", "-o", "again.zip")
    listed = unghost("versions", dataset).out.split("\t")
    unknown = unghost("export", dataset, "--version", "v2", "-o", "other.zip")

    assert again.code == 0, again.err
    assert (tmp_path / "again.zip").read_bytes() == before
    assert listed[:3] == ["v1", (version.version or "")[:12], "decisions-csv"]
    assert "expected one of v1; found 'v2'" in unknown.err
    with zipfile.ZipFile(io.BytesIO(before)) as packed:
        assert packed.read("decisions.csv").count(b"\r\n") == 7


def test_name_is_taken_once_and_since_must_be_known(client, dataset):
    made(client, dataset, "v1")

    with pytest.raises(Conflict, match="has a version 'v1' already") as refused:
        client.start_export(dataset, "yolo", name="v1")
    assert refused.value.code == "version_exists"
    with pytest.raises(NotFound):
        client.start_export(dataset, "yolo", since="v7")


def test_versions_are_kept_when_old_exports_make_place(serve):
    service = serve(max_export_bytes=1_024)
    with service.client() as http, Client(str(http.base_url), service.token) as client:
        client.create_dataset(NAME, classes=["car"])
        frames.put(client, NAME, "run/0", 0)
        version = made(client, NAME, "v1", form="yolo")
        other = made(client, NAME, form="coco")
        made(client, NAME, form="kitti")
        until(lambda: client.export(other.id).download is None)

        assert client.export(version.id).download is not None
