"""Which frames a thread of the service measures itself, and which a child process."""

import multiprocessing
import os
from base64 import b64encode
from dataclasses import replace
from zlib import crc32

import cv2
import numpy as np
import pytest

from app.engine.children import PixelPool
from app.measuring.frame_files import SIMPLE_BOXES, FrameFiles, measure_files
from app.measuring.plan import DatasetReading, plan_for
from filter_core import FilterConfig, FilterError, parse_annotation
from tests.support import pool_tasks

WH = (64, 48)
PLAN = plan_for(DatasetReading("town"), FilterConfig())


@pytest.fixture
def pool():
    pixels = PixelPool(1)
    yield pixels
    pixels.close()


def encoded_image(wh=WH, suffix=".png"):
    width, height = wh
    pixels = np.full((height, width, 3), (142, 0, 0), np.uint8)  # all Car
    return cv2.imencode(suffix, pixels)[1].tobytes()


def add_text_chunk(png):
    """The PNG with a chunk of text between its header and its pixels."""
    body = b"tEXtSoftware\0a painter"
    chunk = (len(body) - 4).to_bytes(4, "big") + body + crc32(body).to_bytes(4, "big")
    return png[:33] + chunk + png[33:]


def measure_and_count_processes(
    pool, png, *, wh=WH, boxes=1, plan=PLAN, distance=None, **files
):
    """The percentage of matching pixels, and how many child processes were started."""
    before = processes()
    box = {"class": "car", "xyxy": [4, 4, 40, 40], "distance": distance}
    frame = parse_annotation({"carla_version": "0.9.15", "boxes": [box] * boxes})
    measured = measure_files(pool, plan, frame, FrameFiles(png, wh, **files))
    return float(measured.evidence.match_percent[0]), len(processes() - before)


def processes():
    """The ids of all running child processes, including those of other tests."""
    return {process.pid for process in multiprocessing.active_children()}


def test_simple_segmentation_is_measured_in_the_calling_thread(pool):
    assert measure_and_count_processes(pool, encoded_image()) == (100, 0)
    assert measure_and_count_processes(
        pool, encoded_image((1920, 1080)), wh=(1920, 1080)
    ) == (100, 0)
    assert pool.run_here(pool_tasks.own_pid) == os.getpid()


@pytest.mark.parametrize(
    "options",
    [
        {"png": add_text_chunk(encoded_image())},
        {"png": encoded_image((2048, 1025)), "wh": (2048, 1025)},
        {"png": encoded_image(), "boxes": SIMPLE_BOXES + 1},
        {"png": encoded_image(), "ignore_mask": encoded_image()},
        {
            "png": encoded_image(),
            "plan": replace(PLAN, ignored={"png": b64encode(encoded_image()).decode()}),
        },
        {
            "png": encoded_image(),
            "plan": plan_for(DatasetReading("town"), FilterConfig(evidence="ordered")),
            "distance": 9,
        },
    ],
    ids=["note", "large", "boxes", "mask", "dataset-mask", "channel"],
)
def test_costly_image_is_measured_in_a_child_process(pool, options):
    _, processes = measure_and_count_processes(pool, **options)

    assert processes == 1


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [(28, 1, "it is damaged"), (24, 16, "expected 8 bits per channel, found 16")],
    ids=["interlaced", "deep"],
)
def test_interlaced_or_16_bit_header_is_read_in_a_child_process(
    pool, place, value, message
):
    """A child process finds out that the pixels contradict the header."""
    png = bytearray(encoded_image())
    png[place] = value
    png[29:33] = crc32(png[12:29]).to_bytes(4, "big")
    before = processes()

    with pytest.raises(FilterError, match=message):
        measure_and_count_processes(pool, bytes(png))

    assert len(processes() - before) == 1
