"""A run changes what frames are measured with while some are on their way in."""

from __future__ import annotations

import json
import threading
from dataclasses import replace

import pytest
from sqlalchemy import select

from app.engine.pixels import PixelPool
from app.ingest.service import (
    BatchOf,
    UploadedFrame,
    prepare_frame,
    store,
    store_frame,
    work_on,
)
from app.ingest.tar import IncomingFrame
from app.measuring.queries import EvidenceRepository
from tests.api import frames as scene
from tests.services import running_services

# Counts other pixels, so what was measured before is of no use.
OTHERWISE = {"profile": "carlasimu"}
PATIENCE_S = 2.0


class WatchedPool(PixelPool):
    """Says of each frame that it measures whether others could write meanwhile."""

    def __init__(self, database):
        super().__init__(1)
        self._database = database
        self.others_wrote = []

    def run_here(self, work, *args):
        self._look()
        return super().run_here(work, *args)

    def run(self, work, *args, given_up=None):
        self._look()
        return super().run(work, *args, given_up=given_up)

    def _look(self):
        def write():
            with self._database.write() as session:
                session.scalar(select(1))  # a transaction begins with a statement

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


def upload(street, key):
    annotation = json.dumps(scene.annotation()).encode()
    files = {"segmentation": scene.segmentation()}
    return UploadedFrame(key, annotation, files, street.by)


def has_current_numbers(street, frame_id):
    with street.context.database.read() as session:
        current = street.row(session).active_measurement_id or 0
        return not EvidenceRepository(session).lacking([frame_id], current)


def test_a_frame_is_measured_again_while_others_may_write(street):
    ready = prepare_frame(street.context, street.name, upload(street, "a"))
    street.run(OTHERWISE)

    stored = store_frame(street.context, street.name, ready)

    assert stored.created
    assert has_current_numbers(street, stored.frame_id)
    assert street.context.pixels.others_wrote == [True, True]


def test_so_are_frames_of_a_batch(street):
    batch = BatchOf(street.name, street.by, replace=False)
    annotation = json.dumps(scene.annotation()).encode()
    files = {"segmentation": scene.segmentation()}
    works = [
        work_on(street.context, batch, IncomingFrame(name, annotation, files))
        for name in ("a", "b")
    ]
    street.run(OTHERWISE)

    lines = store(street.context, batch, works)

    assert [line.created for line in lines] == [True, True]
    assert all(has_current_numbers(street, line.frame_id) for line in lines)
    assert street.context.pixels.others_wrote == [True] * 4
