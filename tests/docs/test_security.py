"""docs/security.md names tests that exist for every attack, and lists every limit."""

import re

import pytest

from app.settings import Settings
from tests.support.documents import read
from tests.support.sources import names_of_tests

TEXT = read("docs/security.md")
ATTACKS = re.findall(
    r"^\| (.+?) \| (.+?) \| (.+) \|$", TEXT.split("## Attacks")[1], re.M
)
TEST = re.compile(r"`(tests/[\w/]+\.py)::(test_\w+)`")
# Published vulnerabilities of similar services; the document has a row for each.
PUBLISHED = {
    *("CVE-2023-47117", "CVE-2023-43791", "CVE-2026-22033", "CVE-2023-47115"),
    *("CVE-2024-23633", "CVE-2025-25295", "CVE-2026-23516", "CVE-2025-47783"),
    *("CVE-2024-47063", "CVE-2024-37306", "CVE-2024-45393", "CVE-2024-47172"),
    *("CVE-2026-23526", "CVE-2025-62727", "CVE-2026-24486"),
}


@pytest.mark.parametrize(
    ("attack", "tests"), [(attack, tests) for attack, _, tests in ATTACKS[2:]]
)
def test_every_attack_has_tests_that_exist(attack, tests):
    named = TEST.findall(tests)

    assert named, attack
    assert re.sub(TEST, "", tests).strip() == ""
    assert [
        f"{path}::{name}" for path, name in named if name not in names_of_tests(path)
    ] == []


def test_every_published_vulnerability_and_limit_is_listed():
    rows = " ".join(attack for attack, _, _ in ATTACKS)

    assert set(re.findall(r"CVE-\d+-\d+", rows)) == PUBLISHED
    limits = TEXT.split("## Limits")[1].split("## ")[0]

    named = set(re.findall(r"`(MAX_\w+)`", limits))

    assert named == {
        name.upper() for name in Settings.model_fields if name.startswith("max_")
    }
