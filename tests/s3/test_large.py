"""Large archives are put into a bucket and sent from it in parts, in little memory."""

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from filter_core.segmentation.palettes import FAMILIES
from tests.support import frames as scene
from tests.support.pictures import painted, png
from tests.support.s3_service import served_on_s3

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs /proc"),
]

WIDE, HIGH, FRAMES = 2000, 1500, 24
MIB = 1024**2


def peak_bytes(process):
    """The most memory that a process had since `forget_peak`, in bytes."""
    text = Path(f"/proc/{process.pid}/status").read_text()
    return int(text.partition("VmHWM:")[2].split()[0]) * 1024


def forget_peak(process):
    Path(f"/proc/{process.pid}/clear_refs").write_text("5")


@pytest.fixture
def service_with_long_timeout(tmp_path, s3):
    """A service that waits for the store as long as a busy machine may need."""
    with served_on_s3(tmp_path, s3, UNGHOST_STORAGE_TIMEOUT_S="60") as running:
        yield running


@pytest.fixture
def export(service_with_long_timeout):
    """A large export, and by how many bytes the process grew while it was written.

    The images of its frames cannot be compressed.
    """
    api, process = (
        service_with_long_timeout.api,
        service_with_long_timeout.server.process,
    )
    dataset = api.dataset()
    tags = np.full((HIGH, WIDE), FAMILIES[scene.FAMILY].tag_of("Road"), np.uint8)
    segmentation = png(painted(tags))
    noise = np.random.default_rng(7)
    annotation = {"carla_version": "0.9.15", "boxes": []}
    for number in range(FRAMES):
        pixels = noise.integers(0, 256, (HIGH, WIDE, 3), np.uint8)
        written, image = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 0])
        assert written
        files = {"image": image.tobytes(), "segmentation": segmentation}
        api.upload_frame(dataset, f"{number:03}", annotation, **files)
    forget_peak(process)
    before = peak_bytes(process)
    body = {"format": "yolo", "options": {"images": "copy"}}
    made = api.wait_for_job(api.post(f"/datasets/{dataset}/exports", body))
    assert made["state"] == "done"
    assert made["size_bytes"] > 200 * MIB
    return made, peak_bytes(process) - before


def test_large_export_is_stored_and_downloaded_in_bounded_memory(
    service_with_long_timeout, export
):
    made, grown_while_put = export
    process, digest = service_with_long_timeout.server.process, hashlib.sha256()
    forget_peak(process)
    before = peak_bytes(process)

    with service_with_long_timeout.api.http.stream("GET", made["download"]) as response:
        for piece in response.iter_bytes():
            digest.update(piece)

    grown = peak_bytes(process) - before
    print(
        f"{made['size_bytes'] / MIB:.0f} MiB: {grown_while_put / MIB:.0f} MiB more "
        f"while it was written, {grown / MIB:.0f} MiB while it was sent"
    )
    assert digest.hexdigest() == made["sha256"]
    assert grown < 64 * MIB
    assert grown_while_put < 128 * MIB
