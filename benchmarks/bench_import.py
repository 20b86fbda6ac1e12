"""How long an import takes, each in a process of its own: the median of several.

    python -m benchmarks.bench_import [--json]

The imports alternate, so that other work on the machine affects all of them. The first
round is not counted, because it reads files that are not in memory yet. `filter_core`
is compared with the packages that it needs, numpy and OpenCV: it cannot take less time.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
from functools import partial

from benchmarks.measuring import parser_of, show

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
    parser = parser_of(__doc__)
    options = parser.parse_args()
    programs = [_PROGRAM.format(statement=each) for each in STATEMENTS]
    commands = [[sys.executable, "-c", program] for program in programs]
    call = partial(subprocess.run, check=True, stdout=subprocess.PIPE)
    _, *rounds = (
        [float(call(command).stdout) for command in commands] for _ in range(TIMES + 1)
    )
    taken = dict(zip(STATEMENTS, zip(*rounds, strict=True), strict=True))
    figures = {f"{one}, ms": statistics.median(taken[one]) for one in STATEMENTS}
    ratios = (
        mine / least for mine, least in zip(taken[LIBRARY], taken[NEEDED], strict=True)
    )
    figures[f"{LIBRARY} / {NEEDED}"] = statistics.median(ratios)
    show(figures, as_json=options.json)


if __name__ == "__main__":
    main()
