"""No file holds a path of somebody's own machine."""

import re

from tests.support.sources import page_sources, python_sources, sources

MACHINE_PATH = re.compile(
    r"""["'(\s](/(home|root|work|Users|mnt|srv)/|/tmp/\w|[A-Z]:\\\\Users)"""
)


def test_no_file_contains_an_absolute_local_path():
    documents = sources((".ci", "docs"), ".md", ".yaml", ".yml", ".toml")
    places = [
        f"{source.name}:{number}"
        for source in (*python_sources(), *page_sources(), *documents)
        for number, line in enumerate(source.lines, 1)
        if MACHINE_PATH.search(line)
    ]

    assert places == []
