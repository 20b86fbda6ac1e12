"""Downloads: interrupted ones are resumed, and only a complete file appears."""

import hashlib
import os
from dataclasses import replace
from pathlib import Path

import pytest

from tests.support import response_checks
from tests.support.scripted_server import SHORT_RETRIES, Reply
from unghost import Client, DamagedDownload, Export, NoResponse

CONTENT = bytes(range(256)) * 40
DIGEST = hashlib.sha256(CONTENT).hexdigest()
EXPORT = Export.read(
    {**response_checks.EXPORT, "sha256": DIGEST, "size_bytes": len(CONTENT)}
)
AWAY = Reply(503, b"{}", {"Retry-After": "0"})


def partial_content_reply(start: int) -> Reply:
    span = f"bytes {start}-{len(CONTENT) - 1}/{len(CONTENT)}"
    return Reply(206, CONTENT[start:], {"Content-Range": span})


def test_download_writes_only_the_file(scripted, client, tmp_path):
    scripted.answer(Reply(body=CONTENT))
    seen = []

    client.download(
        EXPORT, tmp_path / "out" / "x.zip", progress=lambda *at: seen.append(at)
    )

    assert (tmp_path / "out" / "x.zip").read_bytes() == CONTENT
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["x.zip"]
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert scripted.received_requests[0].path == "/api/v1/exports/4/download"


@pytest.mark.parametrize(
    "replies",
    [
        pytest.param([partial_content_reply(5000)], id="resumed"),
        pytest.param([AWAY, AWAY, partial_content_reply(5000)], id="after a restart"),
        pytest.param([Reply(body=CONTENT)], id="by a server that ignores ranges"),
    ],
)
def test_interrupted_download_is_completed(scripted, client, tmp_path, replies):
    scripted.answer(Reply(body=CONTENT, hang_up=5000), *replies)

    client.download(EXPORT, tmp_path / "x.zip")

    assert (tmp_path / "x.zip").read_bytes() == CONTENT
    assert scripted.received_requests[1].headers["Range"] == "bytes=5000-"


def test_download_retries_are_reset_only_by_received_bytes(scripted, client, tmp_path):
    starts = range(0, len(CONTENT), 999)
    scripted.answer(
        *[replace(partial_content_reply(start), hang_up=999) for start in starts]
    )
    client.download(EXPORT, tmp_path / "x.zip")
    assert (tmp_path / "x.zip").read_bytes() == CONTENT

    scripted.answer_always(Reply(body=CONTENT, hang_up=0))
    with (
        Client(scripted.url, "secret", retry=SHORT_RETRIES) as impatient,
        pytest.raises(NoResponse),
    ):
        impatient.download(EXPORT, tmp_path / "y.zip")


def test_later_download_resumes_from_the_part_file(scripted, client, tmp_path):
    scripted.answer_always(Reply(body=CONTENT, hang_up=0))
    with (
        Client(scripted.url, "secret", retry=SHORT_RETRIES) as impatient,
        pytest.raises(NoResponse),
    ):
        impatient.download(EXPORT, tmp_path / "x.zip")
    (part,) = tmp_path.iterdir()
    part.write_bytes(CONTENT[:7000])

    scripted.answer(partial_content_reply(7000))
    client.download(EXPORT, tmp_path / "x.zip")

    assert (tmp_path / "x.zip").read_bytes() == CONTENT


def test_download_with_wrong_digest_raises_and_keeps_old_file(
    scripted, client, tmp_path
):
    (tmp_path / "x.zip").write_bytes(b"the one before")
    scripted.answer(Reply(body=CONTENT[::-1]))

    with pytest.raises(DamagedDownload, match=r"x\.zip: got SHA-256"):
        client.download(EXPORT, tmp_path / "x.zip")

    assert (tmp_path / "x.zip").read_bytes() == b"the one before"
    assert len(list(tmp_path.iterdir())) == 1


PART = f"x.zip.{DIGEST[:12]}.part"


def lay_file_of_another_user(part, private):
    part.write_bytes(CONTENT[:4])
    os.chown(part, 65534, 65534)


@pytest.mark.parametrize(
    "lay",
    [
        Path.symlink_to,
        Path.hardlink_to,
        pytest.param(
            lay_file_of_another_user,
            marks=pytest.mark.skipif(os.geteuid() != 0, reason="needs root"),
        ),
    ],
)
def test_download_continues_no_link_and_no_file_of_another_user(
    scripted, client, tmp_path, lay
):
    private = tmp_path / "private.txt"
    private.write_bytes(CONTENT[:4])
    out = tmp_path / "out"
    out.mkdir()
    lay(out / PART, private)
    scripted.answer(Reply(body=CONTENT))

    client.download(EXPORT, out / "x.zip")

    assert private.read_bytes() == CONTENT[:4]
    assert "Range" not in scripted.received_requests[0].headers
    assert not (out / "x.zip").is_symlink()
    assert (out / "x.zip").read_bytes() == CONTENT
    assert [file.name for file in out.iterdir()] == ["x.zip"]


def test_download_of_unknown_digest_writes_through_no_link(scripted, client, tmp_path):
    private = tmp_path / "private.txt"
    private.write_text("mine")
    (tmp_path / "x.zip.unknown.part").symlink_to(private)
    scripted.answer(Reply(body=CONTENT))

    client.download(EXPORT.model_copy(update={"sha256": None}), tmp_path / "x.zip")

    assert private.read_text() == "mine"
    assert (tmp_path / "x.zip").read_bytes() == CONTENT
