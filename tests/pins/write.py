"""Rewrites stored pins: ``python -m tests.pins.write [NAME ...]``.

The docstring of `tests.pins` says when that is allowed.
"""

import os
import sys

from tests.pins import stored
from tests.pins.pinned import PINS


def main(names: list[str]) -> None:
    unknown = [name for name in names if name not in PINS]
    if unknown:
        sys.exit(f"no pin {unknown[0]!r}; there are {', '.join(PINS)}")
    for name in [key for key in os.environ if key.startswith("UNGHOST_")]:
        del os.environ[name]
    for name in names or PINS:
        print(stored.write(name, PINS[name]()))


if __name__ == "__main__":
    main(sys.argv[1:])
