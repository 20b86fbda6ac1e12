"""The limit on bytes of requests in memory."""

import gc
import json
import tracemalloc
from contextlib import ExitStack, closing
from uuid import uuid4

import pytest

from app.incoming import OpenBodies
from tests.support import frames as scene
from tests.support.api import Api
from tests.support.archives import END, header_of, lines_of, send, tar_without_end
from tests.support.archives import frame as members_of
from tests.support.connections import open_connection, read_response, request_head
from tests.support.live import live
from tests.support.waiting import until

MOST = 600_000
BODY = 500_000
LIMITS = {
    "max_open_body_bytes": MOST,
    "max_body_bytes": 900_000,
    "max_json_bytes": 800_000,
    "workers": 2,
}


@pytest.fixture(scope="module")
def service(tmp_path_factory):
    with live(tmp_path_factory.mktemp("open") / "data", **LIMITS) as running:
        with running.admin() as client:
            assert client.post("/api/v1/datasets", json={"name": "street"}).is_success
        yield running


@pytest.fixture
def bearers(as_role):
    """The Authorization headers of three reviewers."""
    return [as_role("reviewer").headers["authorization"] for _ in range(3)]


@pytest.fixture(autouse=True)
def wait_for_release(service):
    yield
    until_free(service)


def until_free(service):
    """Wait until no bytes are counted: some requests end just after their response."""
    until(lambda: open_bytes(service) == 0, lambda: open_bytes(service))


def open_bytes(service):
    return service.app.state.services.one(OpenBodies).open_bytes


class Sender:
    """A connection on which the body of a request is sent piece by piece."""

    def __init__(self, service, bearer):
        self.socket = open_connection(service.url)
        self.bearer = bearer

    def begin(self, headers, method="POST", path="/probe/echo", sent=b"x"):
        head = request_head(method, path, {"Authorization": self.bearer, **headers})
        self.socket.sendall(head + sent)

    def announce(self, size, **how):
        self.begin({"Content-Length": size}, **how)

    def send(self, content):
        self.socket.sendall(content)

    def answer(self):
        return read_response(self.socket)

    def close(self):
        self.socket.close()


@pytest.fixture
def sender(service):
    """Makes senders for a token; their connections are closed when the test ends."""
    with ExitStack() as opened:
        yield lambda bearer: opened.enter_context(closing(Sender(service, bearer)))


def until_counted(service, size):
    """Wait until this many bytes are counted: then a request has been admitted."""
    until(lambda: open_bytes(service) == size, lambda: open_bytes(service))


def test_open_body_limit_returns_503(service, bearers, sender):
    first, second = sender(bearers[0]), sender(bearers[1])
    first.announce(BODY)
    until_counted(service, BODY)

    second.announce(BODY)
    status, headers, body = second.answer()
    first.send(b"x" * (BODY - 1))

    assert (status, headers["retry-after"]) == (503, "2")
    assert headers["content-type"] == "application/problem+json"
    assert b'"code":"not_ready"' in body
    assert first.answer()[0] == 200
    until_free(service)


def test_refused_body_can_be_retried_on_the_same_connection(service, bearers, sender):
    bearer = bearers[0]
    first, second = sender(bearer), sender(bearer)
    first.announce(BODY)
    until_counted(service, BODY)
    second.announce(BODY)
    assert second.answer()[0] == 503
    first.send(b"x" * (BODY - 1))
    assert first.answer()[0] == 200
    until_counted(service, 0)

    second.send(b"x" * (BODY - 1))
    second.announce(BODY, sent=b"x" * BODY)

    assert second.answer()[0] == 200


def test_bytes_of_a_chunked_body_are_counted_as_they_arrive(service, bearers, sender):
    chunk = b"%x\r\n" % 100_000 + b"x" * 100_000 + b"\r\n"
    first, second = sender(bearers[0]), sender(bearers[0])
    first.announce(BODY)
    until_counted(service, BODY)

    second.begin({"Transfer-Encoding": "chunked"}, sent=chunk)
    until_counted(service, BODY + 100_000)
    second.send(chunk)

    assert second.answer()[0] == 503
    until_counted(service, BODY)


def test_small_bodies_and_a_large_one_alone_are_accepted(service, bearers, sender):
    with service.client(Authorization=bearers[2]) as client:
        alone = client.post("/probe/echo", content=b"x" * 800_000)
        until_free(service)
        sender(bearers[0]).announce(BODY)
        until_counted(service, BODY)

        assert alone.json() == 800_000
        assert client.post("/probe/echo", content=b"x" * 60_000).status_code == 200
        assert client.get("/healthz").status_code == 200


def disconnect(sender):
    sender.announce(BODY)
    sender.close()


def send_too_much(sender):
    sender.begin(
        {"Transfer-Encoding": "chunked"}, sent=b"f4240\r\n" + b"x" * 1_000_000 + b"\r\n"
    )
    assert sender.answer()[0] == 413


def send_body_without_media_type(sender):
    sender.announce(BODY, path="/api/v1/reviews/bulk", sent=b"x" * BODY)
    assert sender.answer()[0] == 415


def send_incomplete_form(sender):
    sender.begin(
        {"Content-Length": BODY, "Content-Type": "multipart/form-data; boundary=b"},
        method="PUT",
        path="/api/v1/datasets/street/frames/a",
        sent=b"x" * BODY,
    )
    assert sender.answer()[0] == 400


@pytest.mark.parametrize(
    "act",
    [disconnect, send_too_much, send_body_without_media_type, send_incomplete_form],
)
def test_counted_bytes_are_released_when_the_request_ends(
    service, bearers, sender, act
):
    act(sender(bearers[0]))

    until_free(service)
    again = sender(bearers[0])
    again.announce(BODY, sent=b"x" * BODY)
    assert again.answer()[0] == 200


PADDING = b"x" * (BODY // 2)


def form(**parts):
    """A multipart form of these parts: its media type, and its bytes."""
    lines = [
        b"--b\r\nContent-Disposition: form-data; name=%b\r\n\r\n%b\r\n"
        % (name.encode(), content)
        for name, content in parts.items()
    ]
    return "multipart/form-data; boundary=b", b"".join(lines) + b"--b--\r\n"


ANNOTATION = scene.as_json(scene.annotation())
FRAME, BATCH = "/api/v1/datasets/street/frames/a", "/api/v1/datasets/street/batches"
NOTE = json.dumps({"name": [PADDING.decode()]}).encode()
JSON, FORM = "application/json", "multipart/form-data; boundary=b"
WITH_PADDING = tar_without_end([("a.json", ANNOTATION), ("a.image.png", PADDING)]) + END
REFUSED = {
    "an image that is none": (FRAME, *form(annotation=ANNOTATION, image=PADDING)),
    "an annotation that is none": (FRAME, *form(annotation=PADDING)),
    "a part of no meaning": (FRAME, *form(annotation=b"{}", nothing=PADDING)),
    "a part without a name": (FRAME, FORM, PADDING),
    "no JSON": ("/api/v1/datasets", JSON, PADDING),
    "JSON of another form": ("/api/v1/datasets", JSON, NOTE),
    "no tar": (BATCH, "application/x-tar", PADDING),
    "a frame of a batch": (BATCH, "application/x-tar", WITH_PADDING),
}


@pytest.mark.parametrize("what", REFUSED)
def test_refused_body_is_not_kept_in_memory(service, bearers, sender, what):
    path, media_type, content = REFUSED[what]
    headers = {"Content-Type": media_type, "Idempotency-Key": "k"}
    headers["Content-Length"] = len(content)
    method = "PUT" if path == FRAME else "POST"
    client = sender(bearers[0])

    def send():
        client.begin(headers, method=method, path=path, sent=content)
        status, _, body = client.answer()
        assert status >= 400 or b'"refused":1' in body.replace(b" ", b""), body
        until_free(service)

    send()
    gc.collect()
    gc.disable()  # the garbage collector may not run for minutes
    tracemalloc.start()
    try:
        for _ in range(5):
            send()
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
        gc.enable()

    # The connection may still hold the last body.
    assert kept // len(PADDING) < 4


def test_batch_over_the_open_body_limit_ends_with_503(service, admin, bearers, sender):
    """The first frame is stored; the second is incomplete, and so kept and counted."""
    first = sender(bearers[0])
    first.announce(BODY)
    until_counted(service, BODY)
    start = tar_without_end(members_of("a"))
    rest = tar_without_end(members_of("b")) + header_of("b.lidar.bin", 300_000)
    rest += b"x" * 299_000

    dataset = f"kept-{uuid4().hex}"
    assert admin.post("/api/v1/datasets", json={"name": dataset}).is_success
    with service.client(Authorization=bearers[0]) as client:
        response = send(Api(client), dataset, iter([start, rest]))
    stored, end = lines_of(response.text)

    assert (stored["status"], end["stored"]) == (201, 1)
    assert (end["problem"]["status"], end["problem"]["code"]) == (503, "not_ready")


def test_batch_releases_the_counted_bytes_of_stored_frames(service, bearers):
    many = b"".join(
        tar_without_end(
            [*members_of(f"m{n}", number=n), (f"m{n}.lidar.bin", b"x" * 200_000)]
        )
        for n in range(6)
    )

    pieces = (many[at : at + 50_000] for at in range(0, len(many), 50_000))

    with service.client(Authorization=bearers[0]) as client:
        response = send(Api(client), "street", pieces)
        send(Api(client), "street", many + END)

    assert len(lines_of(response.text)) >= 2
    until_free(service)
