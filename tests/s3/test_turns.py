"""A request that waits for the bucket does not keep others from writing."""

from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.support import frames as scene
from tests.support.s3_server import gate
from tests.support.services import ServiceDataset, running_services
from tests.support.waiting import until

PATIENCE_S = 20.0


@pytest.fixture
def street_and_gate(tmp_path, s3):
    """A dataset with a frame, and the gate between its service and the bucket.

    The frame was stored by an earlier service, so that this one has to ask the bucket
    whether the frame's files are still there.
    """
    bucket = s3.bucket()
    with gate(bucket.url) as way:
        chosen = bucket.behind(way.url, storage_timeout_s=PATIENCE_S).settings
        with running_services(tmp_path, **chosen) as services:
            street = services.dataset()
            put(street, "a")
        with running_services(tmp_path, **chosen) as services:
            yield ServiceDataset(services, street.name, street.id), way


def put(street, key):
    files = {"image": scene.image(), "segmentation": scene.segmentation()}
    return street.put(key, scene.annotation(), **files)


def test_lookup_of_existing_blobs_does_not_block_other_writers(street_and_gate):
    street, way = street_and_gate
    turns = street.context.database.turns

    turns.take(person=True, wait_s=PATIENCE_S)
    with ThreadPoolExecutor(1) as pool:
        try:
            frame = pool.submit(put, street, "b")
            until(lambda: turns.waiting == 1)
            way.hold()
        finally:
            turns.give_back()
        try:
            turns.take(person=True, wait_s=PATIENCE_S / 2)
            turns.give_back()
            assert not frame.done()
        finally:
            way.flow()

        assert frame.result().verdicts
