"""docs/benchmarks.md lists every benchmark, and each of them has a docstring."""

import ast
import re

from tests.support.documents import read
from tests.support.sources import CHECKOUT


def test_every_benchmark_is_listed():
    scripts = {path.name for path in (CHECKOUT / "benchmarks").glob("bench_*.py")}

    assert set(re.findall(r"`(bench_\w+\.py)`", read("docs/benchmarks.md"))) == scripts


def test_every_benchmark_has_a_docstring():
    for path in (CHECKOUT / "benchmarks").glob("bench_*.py"):
        assert ast.get_docstring(ast.parse(path.read_text("utf-8"))), path.name
