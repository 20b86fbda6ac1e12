"""`push` sends frames in batches, and reports what became of each, after faults too."""

import os
from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import pytest

from tests.support.batch_server import BatchReply, BatchServer
from tests.support.scripted_server import QUICK_RETRIES, SHORT_RETRIES
from unghost import (
    Client,
    Conflict,
    NoResponse,
    NotSent,
    OutgoingFrame,
    Sent,
    Unauthorized,
    UnexpectedAnswer,
)
from unghost.client.call import MAX_JSON_BYTES
from unghost.client.duplex import MAX_LINE_BYTES

BOX = {"class": "car", "xyxy": [0, 0, 1, 1]}


@pytest.fixture
def batches() -> Iterator[BatchServer]:
    server = BatchServer()
    yield server
    server.close()


@pytest.fixture
def client(batches: BatchServer) -> Iterator[Client]:
    with Client(batches.url, "secret", retry=QUICK_RETRIES) as client:
        yield client


def outgoing_frame(key: str, **files: bytes) -> OutgoingFrame:
    return OutgoingFrame(key, {"boxes": [BOX]}, files)


def many(count: int) -> list[OutgoingFrame]:
    return [outgoing_frame(f"{number}") for number in range(count)]


def outcomes_by_key(outcomes) -> dict[str, str]:
    return {outcome.key: outcome.word for outcome in outcomes}


def test_push_sends_frame_with_annotation_and_files(batches, client, tmp_path):
    (tmp_path / "a.png").write_bytes(b"pixels" * 200_000)
    files = {"image": tmp_path / "a.png", "depth": b"metres"}
    frame = OutgoingFrame("a b/ü?#%2F", {"map": "ü", "boxes": [BOX]}, files)

    (outcome,) = client.push("town", [frame], replace=True)

    assert isinstance(outcome, Sent)
    assert (outcome.word, outcome.counts.rejected) == ("stored", 2)
    (taken,) = batches.taken
    assert (taken.key, taken.annotation) == ("a b/ü?#%2F", dict(frame.annotation))
    assert taken.files == {"image": b"pixels" * 200_000, "depth": b"metres"}
    path, head = batches.heads[0]
    assert path == "/api/v1/datasets/town/batches?replace=true"
    assert head["authorization"] == "Bearer secret"


def test_push_skips_frame_with_unchanged_content(batches, client, tmp_path):
    (tmp_path / "a.png").write_bytes(b"pixels")
    frame = OutgoingFrame("a", {"boxes": [BOX]}, {"image": tmp_path / "a.png"})
    batches.known["a"] = frame.digest()

    assert outcomes_by_key(client.push("town", [frame])) == {"a": "already_there"}
    assert batches.taken == []


CHANGED = {
    "as many other bytes": outgoing_frame("a", image=b"j"),
    "another kind of file": outgoing_frame("a", depth=b"i"),
    "another box": OutgoingFrame("a", {"boxes": [{**BOX, "id": 7}]}, {"image": b"i"}),
}


@pytest.mark.parametrize("changed", CHANGED.values(), ids=CHANGED)
def test_push_sends_frame_with_changed_content(batches, client, changed):
    batches.known["a"] = outgoing_frame("a", image=b"i").digest()

    assert outcomes_by_key(client.push("town", [changed])) == {"a": "stored"}


def test_push_resends_only_unanswered_frames_after_disconnect(batches, client):
    batches.replies = [BatchReply(lines=4), BatchReply(lines=3), BatchReply()]

    outcomes = list(client.push("town", many(12)))

    assert outcomes_by_key(outcomes) == {frame.key: "stored" for frame in many(12)}
    assert batches.keys == [frame.key for frame in many(12)]


def test_push_to_a_server_that_stays_away_says_what_is_stored(batches):
    batches.replies = [BatchReply(lines=3), *[BatchReply(lines=0)] * 1000]

    with (
        Client(batches.url, "secret", retry=SHORT_RETRIES) as client,
        pytest.raises(NoResponse) as caught,
    ):
        list(client.push("town", many(9)))

    assert str(caught.value) == (
        f"no response from {batches.url}: the connection was closed before the "
        "response was complete; gave up after 0 s; 3 frames are stored, and pushing "
        "the same frames again sends only the others"
    )


@pytest.mark.parametrize("dropped", [0, 5], ids=["busy", "restarted"])
def test_push_survives_a_busy_or_restarted_server(batches, client, dropped):
    batches.replies = [BatchReply(refusal=(503, "busy", {"Retry-After": "0"}))]
    batches.dropped_requests = dropped

    outcomes = outcomes_by_key(client.push("town", many(2)))

    assert outcomes == {"0": "stored", "1": "stored"}


def test_push_to_server_without_batches_sends_single_frames(batches, client):
    batches.replies = [BatchReply(refusal=(404, "not_found", {}))] * 2

    frames = [outgoing_frame(key) for key in ("a b", "../a", "c")]
    outcomes = outcomes_by_key(client.push("town", frames))

    # A frame whose key is no address is refused alone.
    assert outcomes == {"a b": "stored", "../a": "refused", "c": "stored"}
    assert batches.put == [
        "/api/v1/datasets/town/frames/a%20b",
        "/api/v1/datasets/town/frames/c",
    ]


def test_push_through_a_proxy_sends_single_frames(batches, client, monkeypatch):
    monkeypatch.setenv("http_proxy", batches.url)
    with Client("http://far.example", "secret", retry=QUICK_RETRIES) as far:
        list(far.push("town", [outgoing_frame("a")]))

    assert batches.put == ["http://far.example/api/v1/datasets/town/frames/a"]
    assert batches.heads == []


def test_push_of_single_frames_goes_on_after_one_that_others_have_answered(
    batches, client
):
    batches.replies = [BatchReply(refusal=(404, "not_found", {}))] * 3
    batches.others_answered = {"a"}

    frames = [outgoing_frame("a"), outgoing_frame("b")]
    outcomes = list(client.push("town", frames, replace=True))

    assert len(batches.put) == 2
    refused = [outcome for outcome in outcomes if isinstance(outcome, NotSent)]
    assert {frame.key: str(frame.error) for frame in refused} == {"a": "by others"}


UNREADABLE = "has a line that cannot be read"
GZIP = {"Content-Encoding": "gzip"}
LONG, LONGER = "has a line of more than", "is longer than"


@pytest.mark.parametrize(
    ("reply", "error", "words"),
    [
        (BatchReply(refusal=(401, "unauthorised", {})), Unauthorized, None),
        (BatchReply(end={"problem": {"status": 409, "code": "odd"}}), Conflict, None),
        (BatchReply(decisions=None), UnexpectedAnswer, UNREADABLE),
        (BatchReply(decisions={}), UnexpectedAnswer, UNREADABLE),
        (BatchReply(decisions="many"), UnexpectedAnswer, UNREADABLE),
        (BatchReply(decisions="x" * MAX_LINE_BYTES * 2), UnexpectedAnswer, LONG),
        (BatchReply(refusal=(401, "no", GZIP)), UnexpectedAnswer, "encoded as 'gzip'"),
        (BatchReply(refusal=(401, "x" * MAX_JSON_BYTES, {})), UnexpectedAnswer, LONGER),
    ],
)
def test_push_stops_at_a_refused_or_unreadable_batch(
    batches, client, reply, error, words
):
    batches.replies = [reply]

    with pytest.raises(error, match=words):
        list(client.push("town", many(2)))
    assert batches.taken == [] or reply.refusal is None


def test_push_continues_after_refused_frames(batches, client, tmp_path):
    missing = OutgoingFrame("b", {"boxes": []}, {"image": tmp_path / "b.png"})
    unreadable = NotSent("e", ValueError("line 3"))
    folder = OutgoingFrame("d", {"boxes": []}, {"image": tmp_path})
    bad: list[Any] = [missing, outgoing_frame("\udcff"), folder, unreadable]
    frames = [outgoing_frame("a"), *bad, outgoing_frame("c")]

    outcomes = outcomes_by_key(client.push("town", frames))

    assert outcomes == {"a": "stored", "c": "stored"} | {
        frame.key: "refused" for frame in bad
    }


def test_frame_whose_file_is_a_pipe_is_refused_at_once(batches, client, tmp_path):
    file = tmp_path / "pipe.png"
    os.mkfifo(file)
    pipe = OutgoingFrame("pipe", {"boxes": []}, {"image": file})

    outcomes = outcomes_by_key(client.push("town", [pipe, *many(1)]))

    assert outcomes == {"pipe": "refused", "0": "stored"}
    with pytest.raises(OSError, match="not a regular file"):
        client.put_frame("town", "a", {"boxes": []}, image=file)


def test_only_frame_with_file_that_shrinks_during_push_is_refused(
    batches, client, tmp_path
):
    image = tmp_path / "a.png"
    image.write_bytes(b"pixels")

    def frames() -> Iterator[OutgoingFrame]:
        yield from many(240)
        yield OutgoingFrame("a", {"boxes": []}, {"image": image})
        yield from (outgoing_frame(f"after {number}") for number in range(9))
        # 250 frames were taken; the last fifty wait until their batch is full.
        image.write_bytes(b"pix")
        yield outgoing_frame("last")

    outcomes = outcomes_by_key(client.push("town", frames()))

    assert outcomes.pop("a") == "refused"
    assert set(outcomes.values()) == {"stored"}
    # The rest of its batch was sent again, so the server got some frames twice.
    assert set(batches.keys) == set(outcomes)


def test_push_reads_frames_lazily(batches, client):
    taken = 0

    def frames() -> Iterator[OutgoingFrame]:
        nonlocal taken
        for frame in many(20_000):
            taken += 1
            yield frame

    sending = client.push("town", frames(), connections=1)
    next(sending)
    after_one = taken
    sending.close()

    assert after_one <= 1000
    assert len(batches.taken) < 2000


def test_push_limits_keys_per_request_for_known_frames(batches, client):
    list(client.push("town", many(600)))

    assert sum(map(len, batches.asked_about)) == 600
    assert max(map(len, batches.asked_about)) <= 1000


def test_annotation_may_contain_numbers_and_arrays_of_numpy(batches, client):
    box = {"class": "car", "xyxy": np.array([1, 2, 5, 6.5]), "id": np.int64(7)}
    plain = {"class": "car", "xyxy": [1.0, 2.0, 5.0, 6.5], "id": 7}

    list(client.push("town", [OutgoingFrame("a", {"boxes": [box]})]))

    assert batches.taken[0].annotation == {"boxes": [plain]}


def test_frame_whose_annotation_is_no_json_is_refused_alone(batches, client):
    frames = [outgoing_frame("a"), OutgoingFrame("b", {"boxes": {1, 2}}), *many(1)]
    batches.known["b"] = "other"

    outcomes = {outcome.key: outcome for outcome in client.push("town", frames)}

    words = {key: outcome.word for key, outcome in outcomes.items()}
    assert words == {"a": "stored", "b": "refused", "0": "stored"}
    assert "cannot be written as JSON: found a value of type set" in str(
        getattr(outcomes["b"], "error", "")
    )


def test_unknown_file_kind_or_annotation_that_is_no_mapping_raises_type_error(client):
    with pytest.raises(TypeError, match="'seg' is not a file of a frame"):
        client.put_frame("town", "a", {"boxes": []}, seg=b"")
    with pytest.raises(TypeError, match="frame 'a': expected a mapping as annotation"):
        OutgoingFrame("a", cast("dict[str, object]", [BOX]))
