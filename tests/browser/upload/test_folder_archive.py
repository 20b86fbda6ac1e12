"""The archive of dropped files that the page sends has all that the service reads."""

import base64
import io
import tarfile

import numpy as np
import pytest

from filter_core.formats.reading import TEXT_SUFFIXES
from filter_core.formats.recording import LAYOUTS
from filter_core.formats.registry import read_source
from tests.support.folders import LAYOUT_FILES, street_tags, write_files
from tests.support.page.windows import Visitor
from tests.support.pictures import png

pytestmark = pytest.mark.browser

PACK = """async (files) => {
  const { archiveOf, pack } = await import("/static/js/upload/archive.js");
  const entries = files.map(([path, text]) => {
    const blob = new Blob([Uint8Array.from(atob(text), (one) => one.charCodeAt(0))]);
    return { path, open: async () => blob };
  });
  const packed = await pack(entries, "", new AbortController().signal, () => {});
  const archive = archiveOf(packed, "", null);
  return btoa(String.fromCharCode(...new Uint8Array(await archive.arrayBuffer())));
}"""
"""Pack files, given as pairs of path and base64, into the page's tar, as base64."""


def packed(user: Visitor, files: dict[str, bytes]) -> dict[str, bytes]:
    """The files of the archive that the page makes of these files."""
    page = user.open("#/datasets")
    encoded = [[name, base64.b64encode(data).decode()] for name, data in files.items()]
    content = io.BytesIO(base64.b64decode(page.evaluate(PACK, encoded)))
    contents = {}
    with tarfile.open(fileobj=content) as archive:
        for member in archive:
            file = archive.extractfile(member)
            assert file is not None, member.name
            contents[member.name] = file.read()
    return contents


def what_is_read(folder, layout):
    """What the library finds in a folder."""
    source = read_source(folder, layout)
    frames = [(frame.key, frame.annotation, frame.problem) for frame in source]
    return source.classes, source.count, source.unmatched, frames


@pytest.mark.parametrize("layout", LAYOUTS[1:])
def test_archive_has_the_content_that_the_reader_of_each_layout_needs(
    tmp_path, user, layout
):
    noise = np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8)
    photo, segmentation = png(noise), png(street_tags())
    files = {
        name: (segmentation if "seg" in name else photo)
        if name.endswith((".png", ".jpg"))
        else content
        for name, content in LAYOUT_FILES[layout].items()
    }
    whole = write_files(tmp_path / "whole", files)
    sent = write_files(tmp_path / "sent", packed(user, files))

    assert what_is_read(sent, layout) == what_is_read(whole, layout)


def test_archive_has_the_content_of_every_text_that_the_service_reads(user):
    files = {f"a{suffix}": b"text" for suffix in TEXT_SUFFIXES}

    assert packed(user, files) == files
