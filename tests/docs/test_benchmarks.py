"""docs/benchmarks.md lists every benchmark, and each of them has a docstring."""

import ast
import re

from tests.support.documents import read
from tests.support.sources import CHECKOUT


def test_every_benchmark_is_listed_and_has_a_docstring():
    scripts = {path.name: path for path in (CHECKOUT / "benchmarks").glob("bench_*.py")}

    listed = set(re.findall(r"`(bench_\w+\.py)`", read("docs/benchmarks.md")))
    assert listed == scripts.keys()
    for name, path in scripts.items():
        assert ast.get_docstring(ast.parse(path.read_text("utf-8"))), name
