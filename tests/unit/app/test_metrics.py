"""Requests are counted correctly from many threads, and for each service."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from prometheus_client.parser import text_string_to_metric_families

from app.metrics import WORK, RequestMetrics, Scrape

THREADS, EACH = 8, 2_000


def told(registry):
    """The samples of a registry, by name and by the labels `status` and `le`."""
    text = Scrape(registry.collect()).text().decode()
    return {
        (sample.name, sample.labels.get("status"), sample.labels.get("le")): (
            sample.value
        )
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_nothing_is_lost_where_threads_count_at_the_same_time():
    metrics = RequestMetrics("1")

    def count(number):
        for _ in range(EACH):
            metrics.observe("GET", "/here", 200 + number % 2, 0.005)
            metrics.observe_frame(201)

    with ThreadPoolExecutor(THREADS) as threads:
        list(threads.map(count, range(THREADS)))

    found, half = told(metrics.registry), THREADS * EACH / 2
    for status in ("200", "201"):
        assert found["unghost_requests_total", status, None] == half
        assert found["unghost_request_seconds_count", status, None] == half
        # A value that equals a bound is counted in the bucket up to it.
        assert found["unghost_request_seconds_bucket", status, "0.005"] == half
    assert found["unghost_batch_frames_total", "201", None] == THREADS * EACH


def test_services_of_one_process_count_their_own_requests():
    one, other = RequestMetrics("1"), RequestMetrics("1")

    one.observe("GET", "/here", 200, 0.1)

    assert ("unghost_requests_total", "200", None) in told(one.registry)
    assert ("unghost_requests_total", "200", None) not in told(other.registry)


def test_counters_begin_at_nothing_and_say_nothing_of_when():
    names = {name for name, *_ in told(WORK)}

    assert "unghost_frames_refused_total" in names
    assert not [name for name in names if name.endswith("_created")]
