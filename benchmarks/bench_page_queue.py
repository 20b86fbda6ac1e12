"""How long does it take in the queue from an answer until the next box is shown?

    python -m benchmarks.bench_page_queue [--answers 100] [--pause-ms 300] [--json]

A real server, a real Chromium without a graphics card, 1440 x 900, in random order:
nearly every box is on another frame of 1280 x 720 than the one before. The page marks
the moment of the key press and the one after the next box was drawn with its image;
these are the page's own performance measures. `--pause-ms` is the pause before each
answer; with 0 the key is pressed as soon as the next box is shown.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from benchmarks.bench_page import visit
from benchmarks.measuring import parser_of, served, show, store_pictures
from tests.support.page.windows import launched

DATASET: Final = "queue"
FRAMES: Final = 60
BOXES_PER_FRAME: Final = 30
WARM_UP: Final = 5
AIM_MS: Final = 100.0
SHOWN: Final = "() => document.querySelector('.stage')?.dataset.picture === 'shown'"
MEASURED: Final = (
    "(count) => performance.getEntriesByName('queue:next').length >= count"
)
TIMES: Final = (
    "performance.getEntriesByName('queue:next').map((entry) => entry.duration)"
)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--answers", type=int, default=100)
    parser.add_argument("--pause-ms", type=int, default=300)
    options = parser.parse_args()
    with served() as server, launched() as browser:
        store_pictures(server, DATASET, [BOXES_PER_FRAME] * FRAMES)
        page = visit(browser, server)
        page.goto(f"{server.url}/#/datasets/{DATASET}/queue?order=random")
        page.wait_for_function(SHOWN)
        for number in range(options.answers + WARM_UP):
            page.wait_for_timeout(options.pause_ms)
            page.keyboard.press("a" if number % 3 else "x")
            page.wait_for_function(MEASURED, arg=number + 1)
        times: list[float] = page.evaluate(TIMES)[WARM_UP:]
    middle, high = np.percentile(times, [50, 95])
    figures = {
        "answers": float(len(times)),
        "answer to next box, median [ms]": float(middle),
        "answer to next box, 95th percentile [ms]": float(high),
        "answer to next box, longest [ms]": float(max(times)),
        "answer to next box, 95th percentile: aim, at most [ms]": AIM_MS,
    }
    show(figures, as_json=options.json)


if __name__ == "__main__":
    main()
