"""``python -m app``: serve with the settings of the environment."""

from __future__ import annotations

import sys

from pydantic import ValidationError

from app.serve import CannotServe, serve
from app.settings import Settings

USAGE = 2
REFUSED = 1


def main() -> int:
    """Serve until interrupted; the exit code."""
    try:
        serve(Settings())
    except ValidationError as exc:
        for error in exc.errors(include_input=False):
            name = "UNGHOST_" + "_".join(map(str, error["loc"])).upper()
            sys.stderr.write(f"{name}: {error['msg']}\n")
        return USAGE
    except CannotServe as exc:
        sys.stderr.write(f"{exc}\n")
        return REFUSED
    return 0


if __name__ == "__main__":
    sys.exit(main())
