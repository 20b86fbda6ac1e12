"""Frames are measured again if a run changes the config after they were prepared."""

import json
import threading
from dataclasses import replace

import pytest
from sqlalchemy import select

from app.engine.children import PixelPool
from app.ingest.frame import UploadedFrame, UploadRequest
from app.ingest.rows import NewFrame
from app.ingest.service import prepare_frame, store_frames
from app.measuring.queries import EvidenceRepository
from tests.support import frames as scene
from tests.support.services import running_services

# It counts other pixels, so earlier measurements cannot be used.
OTHER_CONFIG = {"profile": "carlasimu"}
PATIENCE_S = 20.0


class WatchedPool(PixelPool):
    """Notes for each measurement whether another thread could write meanwhile."""

    def __init__(self, database):
        super().__init__(1)
        self._database = database
        self.others_wrote = []

    def run_here(self, work, *args):
        self._record_concurrent_write()
        return super().run_here(work, *args)

    def run(self, work, *args, cancelled=None):
        self._record_concurrent_write()
        return super().run(work, *args, cancelled=cancelled)

    def _record_concurrent_write(self):
        def write():
            with self._database.write() as session:
                session.scalar(select(1))  # this statement begins the transaction

        other = threading.Thread(target=write)
        other.start()
        other.join(PATIENCE_S)
        self.others_wrote.append(not other.is_alive())


@pytest.fixture
def street(tmp_path):
    with running_services(tmp_path) as services:
        pool = WatchedPool(services.context.database)
        services = replace(services, context=replace(services.context, pixels=pool))
        yield services.dataset()
        pool.close()


@pytest.mark.parametrize("keys", [["a"], ["a", "b"]])
def test_frames_are_measured_again_without_blocking_other_writers(street, keys):
    request = UploadRequest(street.name, street.by)
    annotation = json.dumps(scene.annotation()).encode()
    files = {"segmentation": scene.segmentation()}
    prepared = [
        prepare_frame(street.context, request, UploadedFrame(key, annotation, files))
        for key in keys
    ]
    street.run(OTHER_CONFIG)

    stored = store_frames(street.context, request, prepared)

    new = [frame for frame in stored if isinstance(frame, NewFrame)]
    assert [frame.key for frame in new] == keys
    with street.context.database.read() as session:
        current = street.row(session).active_measurement_id or 0
        ids = [frame.frame_id for frame in new]
        assert not EvidenceRepository(session).lacking(ids, current)
    assert street.context.pixels.others_wrote == [True] * 2 * len(keys)
