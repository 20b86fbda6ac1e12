"""How long an import takes, each in a process of its own: the median of several.

    python -m benchmarks.bench_import [--json]

The imports alternate, so that other work on the machine affects all of them. The first
round is not counted, because it reads files that are not in memory yet. `filter_core`
is compared with the packages that it needs, numpy and OpenCV: it cannot take less time.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys

NEEDED = "import numpy, cv2"
LIBRARY = "import filter_core"
STATEMENTS = (NEEDED, LIBRARY, "import unghost", "import unghost.cli")
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
    _, *rounds = ([import_ms(one) for one in STATEMENTS] for _ in range(TIMES + 1))
    taken = dict(zip(STATEMENTS, zip(*rounds, strict=True), strict=True))
    figures = {f"{one}, ms": statistics.median(taken[one]) for one in STATEMENTS}
    ratios = (
        mine / least for mine, least in zip(taken[LIBRARY], taken[NEEDED], strict=True)
    )
    figures[f"{LIBRARY} / {NEEDED}"] = statistics.median(ratios)
    if options.json:
        print(json.dumps(figures, indent=1))
    else:
        for label, value in figures.items():
            print(f"{label:40} {value:8.2f}")


def import_ms(statement: str) -> float:
    command = [sys.executable, "-c", _PROGRAM.format(statement=statement)]
    return float(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)


if __name__ == "__main__":
    main()
