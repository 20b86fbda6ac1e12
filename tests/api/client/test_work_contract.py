"""Client and real server speak one language: configs, runs, numbers and exports."""

from __future__ import annotations

import json
import zipfile

import pytest

import unghost

STRICT = {"threshold_small_box": 90}


def test_configs_are_versions_known_by_digest(client, filled):
    added = client.add_config(filled, STRICT)
    same = client.add_config(filled, "threshold_small_box: 90  # percent\n")

    assert same.digest == added.digest
    assert client.config(added.digest).config["threshold_small_box"] == 90
    active = client.active_config(filled)
    assert active.digest != added.digest
    digests = {version.digest for version in client.configs(filled)}
    assert {added.digest, active.digest} <= digests


def test_activating_a_config_is_a_run(client, filled):
    digest = client.add_config(filled, {"min_visible_pixels": 500}).digest
    seen: list[unghost.Run] = []

    run = client.wait(client.set_config(filled, digest), progress=seen.append)

    assert (run.state, run.config) == ("done", digest)
    assert run.finished
    assert seen[-1] == run
    assert client.active_config(filled).digest == digest
    assert client.stats(filled).rejected == 6


def test_a_run_that_is_not_activated_changes_nothing_that_counts(client, filled):
    started = client.start_run(filled, {"min_visible_pixels": 500})
    run = client.wait(started.id, timeout_s=60)

    assert run.counts is not None
    assert run.counts.rejected == 6
    assert client.stats(filled).rejected == 3
    assert run.id in [each.id for each in client.runs(filled)]


def test_a_preview_counts_and_writes_nothing(client, filled):
    preview = client.preview(filled, {"min_visible_pixels": 500})

    assert preview.counts.rejected == 6
    assert preview.flips.kept_to_rejected == preview.flips.total == 3
    assert preview.flips.items[0].before.verdict == "kept"
    assert preview.flips.items[0].after.reason == "no_visible_pixels"
    assert client.stats(filled).rejected == 3


def test_stats_and_histogram(client, filled):
    stats = client.stats(filled)
    histogram = client.histogram(filled, bins=10)

    assert (stats.frames, stats.boxes, stats.kept, stats.rejected) == (3, 6, 3, 3)
    assert stats.by_reason == {"visible": 3, "no_visible_pixels": 3}
    assert stats.by_class["car"].kept == 3
    assert len(histogram.edges) == 11
    assert sum(histogram.classes["car"]) == 6
    assert histogram.thresholds["car"] == 10


def test_an_export_is_made_and_downloaded(client, filled, tmp_path):
    export = client.wait_for_export(client.start_export(filled, "yolo"))

    path = client.download(export, tmp_path / "labels.zip")

    assert export.id in [each.id for each in client.exports(filled)]
    names = zipfile.ZipFile(path).namelist()
    assert any(name.endswith("data.yaml") for name in names)
    assert sum(name.endswith("000001.txt") for name in names) == 1


def test_an_export_that_is_over_cannot_be_cancelled(client, filled):
    export = client.wait_for_export(client.start_export(filled, "yolo"))

    with pytest.raises(unghost.Conflict, match=f"export {export.id} is done already"):
        client.cancel_export(export)


def test_decisions_are_exported_as_lines(client, filled, tmp_path):
    export = client.wait_for_export(client.start_export(filled, "decisions-jsonl"))

    archive = zipfile.ZipFile(client.download(export, tmp_path / "out.zip"))

    (name,) = [name for name in archive.namelist() if name.endswith(".jsonl")]
    lines = [json.loads(line) for line in archive.read(name).splitlines()]
    assert lines
    assert all(isinstance(line, dict) for line in lines)


def test_a_download_goes_on_where_it_stopped(client, filled, tmp_path):
    export = client.wait_for_export(client.start_export(filled, "yolo"))
    whole = client.download(export, tmp_path / "whole.zip").read_bytes()
    part = tmp_path / f"again.zip.{export.sha256[:12]}.part"
    part.write_bytes(whole[:100])
    seen: list[int] = []

    path = client.download(
        export, tmp_path / "again.zip", progress=lambda done, _: seen.append(done)
    )

    assert path.read_bytes() == whole
    assert not part.exists()
    assert seen[-1] == export.size_bytes


def test_a_format_that_is_not_known_is_refused(client, filled):
    with pytest.raises(unghost.ApiError):
        client.start_export(filled, "punch-cards")
