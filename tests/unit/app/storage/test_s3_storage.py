"""What only S3 stores do: look up blobs, retry, time out, and hide server messages."""

import time
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures import TimeoutError as FutureTimeout

import pytest

from app.errors import StorageAway, TryLater
from app.storage.base import BlobsUncertain, sha256_of
from app.storage.s3 import S3Storage
from tests.support.s3_server import gate, server_answering_with

CONTENT = b"an image"
DIGEST = sha256_of(CONTENT)
HOUR_S = 3600


@pytest.fixture
def open_bucket(tmp_path):
    """A function that opens stores; each is closed after the test."""
    opened = []

    def open_store(place):
        opened.append(S3Storage(place, tmp_path / "blobs"))
        return opened[-1]

    yield open_store
    for store in opened:
        store.close()


def test_require_sends_no_request_and_raises_unsure_for_unknown_blobs(s3, open_bucket):
    bucket, another = s3.bucket(), sha256_of(b"another")
    with gate(bucket.url) as way:
        store = open_bucket(bucket.behind(way.url).place())
        store.put({DIGEST: CONTENT})
        way.shut()

        store.require([DIGEST])
        with pytest.raises(BlobsUncertain) as unsure:
            store.require([DIGEST, another])
        assert unsure.value.digests == [another]
        with pytest.raises(StorageAway):
            store.make_sure([another])


def test_blob_of_an_earlier_store_is_unsure_until_it_is_looked_up(s3, open_bucket):
    """A garbage collection may have found it unused, and be about to remove it."""
    bucket = s3.bucket()
    open_bucket(bucket.place()).put({DIGEST: CONTENT})
    store = open_bucket(bucket.place())
    store.put({DIGEST: CONTENT})
    with pytest.raises(BlobsUncertain):
        store.require([DIGEST])

    store.make_sure([DIGEST])

    store.require([DIGEST])


def test_blob_removed_before_its_lookup_raises_try_later(s3, open_bucket):
    bucket = s3.bucket()
    open_bucket(bucket.place()).put({DIGEST: CONTENT})
    store = open_bucket(bucket.place())
    store.put({DIGEST: CONTENT})

    bucket.delete(DIGEST)

    with pytest.raises(TryLater, match="send the frame again"):
        store.make_sure([DIGEST])


def test_young_blob_is_not_removed_for_any_grace_period(s3, open_bucket):
    bucket = s3.bucket()
    store = open_bucket(bucket.place())
    old, young = b"old", b"young"
    with s3.at_another_time(-2 * HOUR_S):
        store.put({sha256_of(old): old})
    store.put({sha256_of(young): young})

    digests = [sha256_of(old), sha256_of(young)]
    removed = store.remove(digests, unused_since=time.time() + HOUR_S)

    assert removed == {sha256_of(old): len(old)}
    store.require([sha256_of(young)])


def test_old_blob_that_is_stored_again_is_not_removed(s3, open_bucket):
    store = open_bucket(s3.bucket().place())
    with s3.at_another_time(-2 * HOUR_S):
        store.put({DIGEST: CONTENT})

    store.put({DIGEST: CONTENT})

    assert store.remove([DIGEST], unused_since=time.time() + HOUR_S) == {}


@pytest.mark.parametrize(
    "status", [pytest.param(500, marks=pytest.mark.long), 503, 403, 404, 400]
)
def test_any_error_status_of_the_bucket_means_it_is_unavailable(
    open_bucket, s3, status
):
    """Clients cannot do anything about it, and do not learn what the server said."""
    with server_answering_with(lambda _: (status, "<Code>Quoted</Code> secret")) as url:
        store = open_bucket(s3.bucket().behind(url).place(timeout_s=0.5))
        for ask in (
            store.check,
            store.prepare,
            lambda: store.put({DIGEST: CONTENT}),
            lambda: store.read(DIGEST),
            lambda: list(store.files()),
            lambda: store.open(DIGEST, size_bytes=8),
        ):
            with pytest.raises(StorageAway) as away:
                ask()
            assert "secret" not in repr(away.value) + str(away.value.__cause__)
            assert away.value.reason.isidentifier()


def test_request_is_retried_after_503_of_the_bucket(open_bucket, s3):
    requests = []

    def answer_503_twice(_):
        requests.append(1)
        return (503, "<Code>SlowDown</Code>") if len(requests) < 3 else (200, "")

    with server_answering_with(answer_503_twice) as url:
        store = open_bucket(s3.bucket().behind(url).place(timeout_s=60.0))
        store.put({DIGEST: CONTENT})

    assert len(requests) == 3


def test_silent_server_is_unavailable_after_the_timeout(open_bucket, s3):
    bucket = s3.bucket()
    with gate(bucket.url) as way:
        store = open_bucket(bucket.behind(way.url).place(timeout_s=0.5))
        way.hold()
        begun = time.monotonic()

        with pytest.raises(StorageAway):
            store.put({DIGEST: CONTENT})

    assert time.monotonic() - begun < 30


def test_draft_waits_while_sixteen_blobs_are_being_sent(open_bucket, s3):
    """Sixteen blobs are being sent; a draft of another one waits."""
    bucket = s3.bucket()
    blobs = {sha256_of(data): data for data in (b"%d" % each for each in range(16))}
    with gate(bucket.url) as way, ThreadPoolExecutor(1) as thread:
        store = open_bucket(bucket.behind(way.url).place())
        way.hold()

        sixteen = store.draft(blobs)
        waiting = thread.submit(store.draft, {DIGEST: CONTENT})
        with pytest.raises(FutureTimeout):
            waiting.result(0.3)
        way.flow()
        store.settle([sixteen, waiting.result()])

        assert store.read(DIGEST) == CONTENT
