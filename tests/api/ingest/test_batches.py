"""Many frames in one request: each has its own result, even if others are refused."""

import gzip
import json
import random
from contextlib import closing

import pytest

from tests.support import frames as scene
from tests.support.archives import (
    END,
    TAR,
    Connection,
    batch_results,
    frame,
    lines_of,
    send,
    tar_archive,
    tar_without_end,
)


def keys(api, dataset):
    items = api.json(f"/datasets/{dataset}/frames", limit=1000)["items"]
    return [item["key"] for item in items]


def test_batch_result_is_streamed_before_the_next_frames_are_sent(api, server):
    dataset = api.dataset()

    with closing(Connection(server, dataset)) as connection:
        connection.send(tar_without_end(frame("0")))
        for number in range(1, 4):
            connection.send(tar_without_end(frame(f"{number}")))
            assert connection.line()["key"] == f"run/{number - 1}"
            assert f"run/{number - 1}" in keys(api, dataset)


def test_invalid_frames_of_a_batch_are_refused_and_others_stored(api):
    dataset = api.dataset()
    members = [
        *frame("a"),
        *frame("bad", boxes=[{"class": "car", "xyxy": [0, 0, "wide", 9]}]),
        ("no-json.json", b"{"),
        *[("torn.json", frame("torn")[0][1]), ("torn.segmentation.png", b"\x89PNG")],
        *[*frame("odd"), ("odd.colour.png", b"x")],
        *[*frame("twice"), ("twice.image", b"x")],
        ("nobody.png", b"x"),
        *frame("key", key="../x"),
        *frame("z"),
    ]

    statuses, end = batch_results(send(api, dataset, tar_archive(members)))

    assert statuses == [
        ("run/a", 201),
        ("run/bad", 422),
        ("no-json", 422),
        ("run/torn", 422),
        ("odd", 422),
        ("nobody.png", 422),
        ("twice", 422),
        ("../x", 422),
        ("run/z", 201),
    ]
    assert (end["stored"], end["refused"]) == (2, 7)
    assert keys(api, dataset) == ["run/a", "run/z"]


def test_batch_problem_equals_that_of_a_single_upload_and_is_listed(api):
    dataset, other = api.dataset(), api.dataset()
    bad = {**scene.annotation(), "boxes": [{"class": "car", "xyxy": [0, 0, "w", 9]}]}
    alone = api.put(other, "run/bad", bad).json()

    (line, _) = lines_of(
        send(api, dataset, tar_archive(frame("bad", boxes=bad["boxes"]))).text
    )

    same = ("status", "code", "detail", "errors", "title")
    assert {k: line["problem"][k] for k in same} == {k: alone[k] for k in same}
    (problem,) = api.json(f"/datasets/{dataset}/problems")["items"]
    assert (problem["key"], problem["error"]["code"]) == ("run/bad", alone["code"])


def test_problem_is_deleted_with_its_frame_or_when_the_stored_content_is_sent_again(
    api,
):
    dataset = api.dataset()
    good, bad = tar_archive(frame("a")), tar_archive(frame("a", boxes=3))

    def keys_of_problems():
        problems = api.json(f"/datasets/{dataset}/problems")["items"]
        return [problem["key"] for problem in problems]

    for solve in (
        lambda: send(api, dataset, good),
        lambda: api.delete(f"/datasets/{dataset}/frames/run/a"),
    ):
        send(api, dataset, good)
        assert batch_results(send(api, dataset, bad))[0] == [("run/a", 422)]
        assert keys_of_problems() == ["run/a"]
        solve()
        assert keys_of_problems() == []


def test_repeated_key_with_other_content_is_409_unless_replaced(api):
    members = frame("a") + frame("b", key="run/a", map="Town01") + frame("a")

    for parameters, expected, last in (
        ({}, [201, 409, 200], 1),
        ({"replace": "true"}, [201, 201, 201], 3),
    ):
        dataset = api.dataset()
        response = send(api, dataset, tar_archive(members), **parameters)
        statuses, _ = batch_results(response)
        assert [status for _, status in statuses] == expected
        assert api.json(f"/datasets/{dataset}/frames/run/a")["revision"] == last


def test_batch_reports_the_answers_that_replacing_a_frame_has_set_aside(api):
    dataset = api.dataset()
    (box, *_) = api.upload_frame(dataset, "run/a")["decisions"]
    assert api.review(box["box_id"], "reject").status_code == 201
    document = {**scene.annotation(), "boxes": [], "key": "run/a"}
    members = [("a.json", json.dumps(document).encode()), *frame("b")]

    archive = tar_archive(members)
    (replaced, new, _) = lines_of(send(api, dataset, archive, replace="true").text)

    assert (replaced["answers_set_aside"], new["answers_set_aside"]) == (1, 0)
    assert (replaced["boxes_set_aside"], new["boxes_set_aside"]) == ([box["id"]], [])


def test_frame_without_a_key_gets_its_file_name_as_key(api):
    dataset = api.dataset()
    content = json.dumps(scene.annotation()).encode()

    statuses, _ = batch_results(
        send(api, dataset, tar_archive([("./town/7.json", content)]))
    )

    assert statuses == [("town/7", 201)]


def test_frame_with_a_new_class_is_refused_alone_when_classes_are_frozen(api):
    dataset = api.dataset(classes=["car"])
    batch_results(send(api, dataset, tar_archive(frame("a"))))
    assert api.post(f"/datasets/{dataset}/exports", {"format": "yolo"}).is_success
    dragon = [{"class": "dragon", "xyxy": scene.ON_THE_CAR}]

    response = send(api, dataset, tar_archive(frame("b", boxes=dragon) + frame("c")))
    described = api.json(f"/datasets/{dataset}")

    refused, stored, _ = lines_of(response.text)
    assert (refused["status"], refused["problem"]["code"]) == (422, "unknown_class")
    assert "'dragon'" in refused["problem"]["detail"]
    assert stored["status"] == 201
    assert (described["classes_frozen"], described["classes"]) == (True, ["car"])
    assert described["counts"]["problems"] == 1


def test_frames_of_a_batch_that_add_too_many_classes_do_not_fail_the_others(api):
    dataset = api.dataset(classes=[f"class {number}" for number in range(999)])
    members = []
    for key in ("a", "b", "c"):  # each alone would fit
        boxes = [{"class": f"of {key}", "xyxy": scene.ON_THE_CAR}]
        members += frame(key, boxes=boxes)
    boxes = [{"class": "class 5", "xyxy": scene.ON_THE_CAR}]

    response = send(api, dataset, tar_archive(members + frame("d", boxes=boxes)))

    *lines, last = lines_of(response.text)
    assert [line["status"] for line in lines] == [201, 422, 422, 201]
    assert {line["problem"]["code"] for line in lines[1:3]} == {"too_many_classes"}
    assert (last["stored"], last["refused"]) == (2, 2)
    counts = api.json(f"/datasets/{dataset}")["counts"]
    assert (counts["frames"], counts["problems"]) == (2, 2)


@pytest.mark.parametrize(
    ("headers", "content", "status", "code"),
    [
        pytest.param({}, b"x", 415, "unsupported_media_type", id="no type"),
        pytest.param({"Content-Type": "application/gzip"}, b"x", 415,
         "unsupported_media_type", id="another type"),
        pytest.param({**TAR, "Content-Encoding": "gzip"},
         gzip.compress(tar_archive(frame("a"))), 415, "unsupported_media_type",
         id="encoded"),
        pytest.param(TAR, gzip.compress(tar_archive(frame("a")), compresslevel=0), 415,
         "unsupported_media_type", id="compressed"),
        pytest.param(TAR, b"x" * 2000, 422, "bad_archive", id="no tar"),
        pytest.param(TAR, b"x", 422, "bad_archive", id="too short"),
        pytest.param(TAR, b"", 422, "bad_archive", id="nothing"),
    ],
)  # fmt: skip
def test_batch_body_that_is_not_a_tar_archive_is_refused(
    api, headers, content, status, code
):
    response = send(api, api.dataset(), content, headers)

    assert (response.status_code, response.json()["code"]) == (status, code)


def test_frames_before_the_damaged_part_of_an_archive_are_stored(api):
    dataset = api.dataset()
    archive = tar_without_end(frame("a") + frame("b")) + b"\xff" * 512 + END

    statuses, end = batch_results(send(api, dataset, archive))

    assert statuses == [("run/a", 201)]
    assert (end["problem"]["code"], end["stored"]) == ("bad_archive", 1)


def test_too_many_open_batches_and_frames_over_their_limits_are_refused(start_api):
    limits = {"UNGHOST_MAX_PART_BYTES": "20000", "UNGHOST_MAX_PARTS": "3"}
    server, api = start_api(UNGHOST_MAX_OPEN_BATCHES="1", **limits)
    dataset = api.dataset()
    large = [("large.json", frame("large")[0][1]), ("large.image.png", bytes(20001))]
    many = [*frame("many"), ("many.depth.png", b"x")]

    with closing(Connection(server, dataset)) as connection:
        connection.send(tar_without_end(frame("a") + frame("b")))
        assert connection.line()["key"] == "run/a"
        refused = send(api, dataset, tar_archive(frame("c")))
        connection.send(END)
        connection.end()
        assert connection.line()["key"] == "run/b"
        assert connection.line()["end"] is True
    statuses, _ = batch_results(
        send(api, dataset, tar_archive(large + many + frame("z")))
    )
    metrics = api.http.get("/metrics").text

    assert (refused.status_code, "retry-after" in refused.headers) == (429, True)
    assert statuses == [("large", 413), ("many", 413), ("run/z", 201)]
    assert 'unghost_batch_frames_total{status="201"} 3' in metrics
    assert 'unghost_batch_frames_total{status="413"} 2' in metrics


def test_batch_with_a_cut_connection_leaves_only_complete_frames(api, server):
    content = b"".join(tar_without_end(frame(f"{n}", number=n)) for n in range(6)) + END
    places = random.Random(7).sample(range(1, len(content)), 12)

    for place in places:
        dataset = api.dataset()
        with closing(Connection(server, dataset)) as connection:
            connection.send(content[:place])
        batch_results(send(api, dataset, tar_archive(frame("last"))))
        for key in keys(api, dataset):
            files = api.json(f"/datasets/{dataset}/frames/{key}")["files"]
            assert files.keys() == {"image", "segmentation"}


def send_until_blocked(connection, archive):
    """Send until the server stops reading; return the number of bytes that it took."""
    sent = 0
    for start in range(0, len(archive), 4096):
        try:
            connection.send(archive[start : start + 4096])
        except TimeoutError:
            return sent
        sent += 4096
    raise AssertionError("all of it was taken")


def test_unread_batch_response_applies_backpressure_to_the_upload(api, server):
    # Many errors make long lines, so few frames fill the buffers of the connection.
    boxes = [{"id": str(number)} for number in range(100)]
    faulty = json.dumps({"boxes": boxes}).encode()
    bad = tar_without_end([(f"{number:05}.json", faulty) for number in range(4000)])

    with closing(Connection(server, api.dataset())) as connection:
        connection.socket.settimeout(2)
        assert send_until_blocked(connection, bad) < len(bad)
        connection.socket.settimeout(60)
        lines = [connection.line()["key"] for _ in range(200)]

    assert lines == [f"{number:05}" for number in range(200)]


def test_idempotency_key_has_no_effect_on_a_batch(api):
    dataset, archive = api.dataset(), tar_archive(frame("a"))
    headers = {**TAR, "Idempotency-Key": "one"}

    first = send(api, dataset, archive, headers)
    again = send(api, dataset, archive, headers)

    assert [batch_results(response)[0] for response in (first, again)] == [
        [("run/a", 201)],
        [("run/a", 200)],
    ]
