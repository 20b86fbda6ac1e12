"""Requests are counted correctly from many threads, and for each service."""

from concurrent.futures import ThreadPoolExecutor

from prometheus_client.parser import text_string_to_metric_families

from app.metrics import WORK, RequestMetrics, prometheus_text

THREADS, EACH = 8, 2_000


def samples_of(registry):
    """The samples of a registry, by name and by the labels `status` and `le`."""
    text = prometheus_text(registry.collect()).decode()
    return {
        (sample.name, sample.labels.get("status"), sample.labels.get("le")): (
            sample.value
        )
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_requests_of_concurrent_threads_are_all_counted():
    metrics = RequestMetrics("1")

    def count(number):
        for _ in range(EACH):
            metrics.observe("GET", "/here", 200 + number % 2, 0.005)
            metrics.observe_frame(201)

    with ThreadPoolExecutor(THREADS) as threads:
        list(threads.map(count, range(THREADS)))

    samples, half = samples_of(metrics.registry), THREADS * EACH / 2
    for status in ("200", "201"):
        assert samples["unghost_requests_total", status, None] == half
        assert samples["unghost_request_seconds_count", status, None] == half
        # A value that equals a bound is counted in the bucket up to it.
        assert samples["unghost_request_seconds_bucket", status, "0.005"] == half
    assert samples["unghost_batch_frames_total", "201", None] == THREADS * EACH


def test_services_of_one_process_have_separate_request_metrics():
    first, other = RequestMetrics("1"), RequestMetrics("1")

    first.observe("GET", "/here", 200, 0.1)

    assert ("unghost_requests_total", "200", None) in samples_of(first.registry)
    assert ("unghost_requests_total", "200", None) not in samples_of(other.registry)


def test_work_counters_exist_from_the_start_without_created_samples():
    names = {name for name, *_ in samples_of(WORK)}

    assert "unghost_frames_refused_total" in names
    assert not [name for name in names if name.endswith("_created")]
