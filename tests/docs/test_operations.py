"""docs/operations.md agrees with the code on metrics, checks, logs and settings."""

import json
import logging
import re

import pytest
import yaml
from prometheus_client.parser import text_string_to_metric_families

from app.db.engine import CACHE_KIB, MOST_CONNECTIONS, WRITER_CACHE_KIB
from app.logs import AccessRecord, JsonLines, access_log, log_access
from app.settings import Settings
from tests.support import plain_http
from tests.support.documents import blocks, read
from tests.support.servers import wait_until_ready
from tests.support.waiting import until

METRIC = re.compile(r"\b(?:unghost|process)_[a-z_]+\b")
SETTING = re.compile(r"\bUNGHOST_[A-Z_]+\b")
BUCKETS = re.compile(r"_(bucket|sum|count)$")


def section(title):
    """A section of the document, up to the next heading."""
    return read("docs/operations.md").partition(f"\n## {title}\n")[2].split("\n## ")[0]


def first_cells(text):
    """The names in backticks in the first column of a section's tables."""
    rows = [line for line in text.splitlines() if line.startswith("| `")]
    return {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}


def exposed_metrics(server):
    """The names of all metrics of a server.

    Waits for those of blobs, which are there only when files have been counted.
    """

    def with_those_of_blobs():
        response = plain_http.get(f"{server.url}/metrics", headers=server.headers)
        families = list(text_string_to_metric_families(response.text))
        # The parser removes the ending from names of counters.
        ends = {"counter": "_total"}
        names = {family.name + ends.get(family.type, "") for family in families}
        return names if "unghost_blobs" in names else None

    return until(with_those_of_blobs, "the files are never counted")


@pytest.mark.sqlite_files("one metric is of its log")
def test_documented_metrics_are_the_exposed_ones_and_alerts_use_no_others(server):
    exposed = exposed_metrics(server)
    assert first_cells(section("Metrics")) == exposed
    (rules,) = (yaml.safe_load(text) for text in blocks(section("Alerts"), "yaml"))
    queries = [rule["expr"] for group in rules["groups"] for rule in group["rules"]]

    names = {BUCKETS.sub("", name) for text in queries for name in METRIC.findall(text)}
    assert len(queries) >= 5
    assert names <= exposed


def test_every_readiness_check_is_documented(server):
    checks = wait_until_ready(server.url).json()["checks"]

    assert first_cells(section("Alive and ready")) == {*checks, "shutdown"}


def test_example_log_line_has_the_keys_of_a_real_log_line(caplog):
    with caplog.at_level(logging.INFO, access_log.name):
        log_access(AccessRecord("GET", "/", "/", 200, 0.1, "ada", "127.0.0.1"))
    (record,) = caplog.records
    (shown,) = (json.loads(text) for text in blocks(section("Logs"), "json"))

    assert list(shown) == list(json.loads(JsonLines().format(record)))
    assert first_cells(section("Logs")) <= {*shown, "traceback"}


def test_every_setting_in_the_document_exists():
    of_the_client = {"UNGHOST_TOKEN"}
    variables = {f"UNGHOST_{name.upper()}" for name in Settings.model_fields}

    assert set(SETTING.findall(read("docs/operations.md"))) <= variables | of_the_client
    most_kib = MOST_CONNECTIONS * CACHE_KIB + WRITER_CACHE_KIB

    assert f"at most {most_kib // 1024} MiB" in read("docs/operations.md")
