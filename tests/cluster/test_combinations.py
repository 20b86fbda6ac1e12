"""A dataset gives the same labels with every combination of engine, database, store."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import pytest

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.cluster import cluster
from tests.support.databases import DATABASE_URL, migrated_postgres
from tests.support.s3_server import S3Server
from tests.support.servers import running_server
from tests.support.slow_datasets import FROM_PIXELS

FORMATS = ("decisions-jsonl", "yolo", "coco", "kitti")
FRAMES = 21
"""More than the least chunk of a cluster."""
LOCAL = ("local", "sqlite", "folder")
ALL_REMOTE = ("cluster", "postgres", "s3")


@contextmanager
def service(places: tuple[str, str, str], folder: Path, s3: S3Server) -> Iterator[Api]:
    """A service with this engine, database and store; gives an API client of it."""
    engine, database, store = places
    settings: dict[str, str] = {}
    with ExitStack() as opened:
        if database == "postgres":
            settings[DATABASE_URL] = opened.enter_context(migrated_postgres())
        if store == "s3":
            settings |= s3.bucket().environment
        if engine == "local":
            server = opened.enter_context(running_server(folder / "data", settings))
            api = Api.at(server.url, server.headers)
            opened.enter_context(api.http)
        else:
            made = opened.enter_context(cluster(folder))
            made.settings.update(settings)
            made.scheduler()
            _, api = opened.enter_context(made.server())
            made.worker()
        yield api


def run_counts_and_export_hashes(api: Api) -> dict[str, Any]:
    """Upload frames, run and export them; give the run's counts and exports' hashes."""
    assert api.post("/datasets", {"name": "same"}).status_code == 201
    for number in range(FRAMES):
        files = {
            "image": scene.image(number),
            "segmentation": scene.segmentation(number % 9),
        }
        api.upload_frame("same", f"{number:02}", scene.annotation(), **files)
    run = api.run("same", {**FROM_PIXELS, "threshold_small_box": 30})
    assert run["state"] == "done", run
    exports = {
        form: api.wait_for_job(api.post("/datasets/same/exports", {"format": form}))
        for form in FORMATS
    }
    told = {key: run[key] for key in ("total", "done", "changed", "counts")}
    return told | {form: made["sha256"] for form, made in exports.items()}


@pytest.fixture(scope="module")
def expected(tmp_path_factory: pytest.TempPathFactory, s3: S3Server) -> dict[str, Any]:
    """What one process with SQLite and a folder makes, to compare the others with."""
    with service(LOCAL, tmp_path_factory.mktemp("alone"), s3) as api:
        return run_counts_and_export_hashes(api)


@pytest.mark.parametrize(
    "places",
    [
        pytest.param(
            places,
            id=" ".join(places),
            marks=[] if places == ALL_REMOTE else [pytest.mark.long],
        )
        for places in product(
            ("local", "cluster"), ("sqlite", "postgres"), ("folder", "s3")
        )
        if places != LOCAL
    ],
)
def test_labels_are_byte_identical_for_every_combination(
    places, expected, tmp_path, s3
):
    with service(places, tmp_path, s3) as api:
        assert run_counts_and_export_hashes(api) == expected
