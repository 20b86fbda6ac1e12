"""An answer is sent only after all that it confirms was flushed in the right order."""

import re

import pytest

from tests.support import frames as scene
from tests.support.api import Api
from tests.support.archives import frame, lines_of, send, tar_archive
from tests.support.system_calls import calls_of, traced_server

pytestmark = pytest.mark.sqlite_files("system calls on its log")

WRITES = ("write", "pwrite64", "sendto", "sendmsg", "writev")
FLUSHES = ("fsync", "fdatasync")
DRAFT = re.compile(r'"([^"]*/blobs/[0-9a-f]{2})/(\.new-[0-9a-f]+)", O_WRONLY')
OUTCOME = '\\"status\\": 201'


@pytest.fixture(scope="module")
def calls(tmp_path_factory):
    """System calls of a server during an upload, a review and a batch of two frames."""
    data = tmp_path_factory.mktemp("traced") / "data"
    with traced_server(data) as (server, trace):
        api = Api.at(server.url, server.headers)
        with api.http:
            dataset = api.dataset()
            api.upload_frame(
                dataset, "one", image=scene.image(1), segmentation=scene.segmentation()
            )
            box = api.boxes(dataset)[0]["box_id"]
            assert api.review(box, "reject").status_code == 201
            members = frame("a", number=7) + frame("b", number=8)
            told = send(api, dataset, tar_archive(members))
            assert [line.get("status") for line in lines_of(told.text)[:2]] == [201] * 2
    return calls_of(trace)


def answers(calls, text):
    """The positions of the calls that begin to send answers with this text."""
    return [
        place
        for place, call in enumerate(calls)
        if call.name in WRITES and "<socket" in call.words and text in call.words
    ]


def last(calls, end, is_meant):
    """The last position before `end` where `wanted(call)` is true; -1: none."""
    places = [place for place in range(end) if is_meant(calls[place])]
    return places[-1] if places else -1


def flushed(path):
    return lambda call: call.name in FLUSHES and f"<{path}>" in call.words


def drafts_between(calls, begin, end):
    """Folder and temporary name of each blob that is written between two positions."""
    opened = [call for call in calls[begin:end] if call.name == "openat"]
    return [match.groups() for call in opened if (match := DRAFT.search(call.words))]


def check_files_are_flushed_before_rows(calls, begin, end, log):
    """Check that each file is written, flushed and renamed, and its folder flushed.

    Only then are rows written to the database's log, which is flushed at the end.
    """
    rows = [
        place
        for place in range(begin, end)
        if calls[place].name == "pwrite64" and log in calls[place].words
    ]
    for folder, name in drafts_between(calls, begin, end):
        draft = f"{folder}/{name}"
        written = last(
            calls, end, lambda c, d=draft: c.name == "write" and d in c.words
        )
        whole = last(calls, end, flushed(draft))
        named = last(
            calls, end, lambda c, d=draft: c.name.startswith("rename") and d in c.words
        )
        kept = last(calls, rows[0], flushed(folder))
        assert begin < written < whole < named < kept < rows[0], draft
    assert last(calls, end, is_flush_of_log(log)) > rows[-1]


def is_flush_of_log(log):
    return lambda call: call.name in FLUSHES and f"/{log}>" in call.words


def test_upload_is_answered_after_its_files_and_rows_are_flushed(calls):
    dataset, frame_answer, _ = answers(calls, "HTTP/1.1 201")[:3]

    assert len(drafts_between(calls, dataset, frame_answer)) == 2
    check_files_are_flushed_before_rows(calls, dataset, frame_answer, "unghost.db-wal")


def test_batch_line_is_sent_after_its_frame_is_flushed(calls):
    before, first = answers(calls, "HTTP/1.1 201")[2], answers(calls, OUTCOME)[0]

    # Two images. The segmentation exists already; only its folder is flushed again.
    assert len(drafts_between(calls, before, first)) == 2
    check_files_are_flushed_before_rows(calls, before, first, "unghost.db-wal")


def test_review_is_answered_after_its_row_is_flushed(calls):
    _, before, review = answers(calls, "HTTP/1.1 201")[:3]

    rows = last(
        calls, review, lambda c: c.name == "pwrite64" and "unghost.db-wal" in c.words
    )
    assert before < rows < last(calls, review, is_flush_of_log("unghost.db-wal"))


def test_new_database_log_and_folders_are_flushed_before_the_first_answer(calls):
    first = answers(calls, "HTTP/1.1 201")[0]
    made = [
        place
        for place, call in enumerate(calls[:first])
        if call.name == "openat" and "unghost.db-wal" in call.words
    ]

    data = re.search(r'"([^"]*)/unghost\.db-wal"', calls[made[0]].words)
    assert data is not None
    assert last(calls, first, flushed(data[1])) > made[0]
    assert last(calls, first, flushed(f"{data[1]}/blobs")) > 0
    parent = data[1].rpartition("/")[0]
    assert last(calls, first, flushed(parent)) > -1
