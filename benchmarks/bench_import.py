"""How long an import takes, each in a process of its own: the median of several.

    python -m benchmarks.bench_import [--json]

The first one reads files that are not in memory yet, so it is not counted.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys

STATEMENTS = ("import filter_core", "import unghost", "import unghost.cli")
TIMES = 9
_PROGRAM = """
import time
started = time.perf_counter()
{statement}
print((time.perf_counter() - started) * 1e3)
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    figures = {f"{statement}, ms": median_ms(statement) for statement in STATEMENTS}
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for label, value in figures.items():
            print(f"{label:28} {value:8.1f}")


def median_ms(statement: str) -> float:
    command = [sys.executable, "-c", _PROGRAM.format(statement=statement)]
    _, *counted = (
        float(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
        for _ in range(TIMES + 1)
    )
    return statistics.median(counted)


if __name__ == "__main__":
    main()
