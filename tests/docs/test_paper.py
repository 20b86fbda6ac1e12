"""The page for readers of the paper has every key of its authors' own files."""

import re

import yaml

from tests.support.documents import read
from tests.support.shared_data import shared

EXPLAINED_TOGETHER = ("lens_", "vehicle.")
"""Beginnings of keys that one row explains."""


def keys_of(value):
    """All keys of a file, also nested ones."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield str(key)
            yield from keys_of(inner)


def test_every_key_of_the_authors_own_files_is_explained():
    page = read("docs/paper.md")
    explained = set(re.findall(r"`([\w.]+)`", page))
    files = sorted(shared("oracles/carlasimu_yaml").glob("*.yaml"))
    assert len(files) == 7
    missing = {}
    for file in files:
        assert file.name in page
        content = yaml.safe_load(file.read_text())["sitting"]
        if file.name in ("weather.yaml", "color_segmentation.yaml"):
            continue  # their keys are those of CARLA, and not needed
        parts = {"lidar_sensor", "radar_sensor", "semantic_lidar"}
        if file.name == "sensors.yaml":
            content = {
                key: None if key in parts else inner for key, inner in content.items()
            }
        missing[file.name] = {
            key
            for key in keys_of(content)
            if key not in explained and not key.startswith(EXPLAINED_TOGETHER)
        }
    assert not any(missing.values()), missing
