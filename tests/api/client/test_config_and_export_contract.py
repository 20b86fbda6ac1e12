"""The client against a real server: configurations, runs, figures and exports."""

from __future__ import annotations

import zipfile

import pytest

import unghost

STRICT = {"threshold_small_box": 90}


def test_config_versions_are_identified_by_digest(client, filled):
    added = client.add_config(filled, STRICT)
    same = client.add_config(filled, "threshold_small_box: 90  # percent\n")

    assert same.digest == added.digest
    assert client.config(added.digest).config["threshold_small_box"] == 90
    active = client.active_config(filled)
    assert active.digest != added.digest
    digests = {version.digest for version in client.configs(filled)}
    assert {added.digest, active.digest} <= digests


def test_stats_and_histogram(client, filled):
    stats = client.stats(filled)
    histogram = client.histogram(filled, bins=10)

    assert (stats.frames, stats.boxes, stats.kept, stats.rejected) == (3, 6, 3, 3)
    assert stats.by_reason == {"visible": 3, "no_visible_pixels": 3}
    assert stats.by_class["car"].kept == 3
    assert len(histogram.edges) == 11
    assert sum(histogram.classes["car"]) == 6
    assert histogram.thresholds["car"] == 10


def test_export_is_created_and_downloaded(client, filled, tmp_path):
    export = client.wait_for_export(client.start_export(filled, "yolo"))

    path = client.download(export, tmp_path / "labels.zip")

    assert export.id in [each.id for each in client.exports(filled)]
    names = zipfile.ZipFile(path).namelist()
    assert any(name.endswith("data.yaml") for name in names)
    assert sum(name.endswith("000001.txt") for name in names) == 1


def test_cancelling_a_finished_export_raises_conflict(client, filled):
    export = client.wait_for_export(client.start_export(filled, "yolo"))

    with pytest.raises(unghost.Conflict, match=f"export {export.id} is done already"):
        client.cancel_export(export)
