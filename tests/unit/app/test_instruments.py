"""Counters and histograms as Prometheus reads them."""

from __future__ import annotations

from prometheus_client.parser import text_string_to_metric_families

from app.metrics import Counter, Gauge, Histogram


def read(instrument):
    """Name, labels and value of each sample, by the reader of Prometheus' client."""
    text = "\n".join((*instrument.lines(), ""))
    (family,) = text_string_to_metric_families(text)
    return family.type, {
        (sample.name, *sorted(sample.labels.items())): sample.value
        for sample in family.samples
    }


def test_a_counter_adds_up_by_its_labels():
    counter = Counter("frames_total", "Frames.", ("kind",))
    for kind, amount in (("a", 1), ("b", 2), ("a", 3)):
        counter.add(amount, kind)

    assert read(counter) == (
        "counter",
        {("frames_total", ("kind", "a")): 4, ("frames_total", ("kind", "b")): 2},
    )


def test_a_counter_without_labels_begins_at_nothing():
    assert read(Counter("frames_total", "Frames.")) == (
        "counter",
        {("frames_total",): 0},
    )


def test_values_fall_into_their_buckets_which_add_up():
    histogram = Histogram("wait_seconds", "Waits.", buckets=(0.005, 1.0))
    for seconds in (0.005, 0.2, 99.0):
        histogram.observe(seconds)

    kind, samples = read(histogram)

    assert kind == "histogram"
    assert samples == {
        ("wait_seconds_bucket", ("le", "0.005")): 1,
        ("wait_seconds_bucket", ("le", "1.0")): 2,
        ("wait_seconds_bucket", ("le", "+Inf")): 3,
        ("wait_seconds_sum",): 99.205,
        ("wait_seconds_count",): 3,
    }


def test_a_label_can_have_any_value():
    odd = 'a "quoted" \\ back\nslash'

    assert read(Gauge("now", "Now.", [({"name": odd}, 1.5)])) == (
        "gauge",
        {("now", ("name", odd)): 1.5},
    )


def test_large_numbers_lose_nothing():
    assert read(Gauge.of("now", "Now.", 2**40 + 1)) == ("gauge", {("now",): 2**40 + 1})
