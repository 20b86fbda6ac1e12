"""Runs `unghost` in a process in which `import carla` finds the fake street.

`python -m tests.support.fake_carla.program STATE ARGS...` runs ``unghost ARGS...`` and
always writes the final state of the fake world to the file STATE.
"""

import json
import sys
from pathlib import Path

from tests.support.fake_carla.library import as_library
from tests.support.fake_carla.street import street


def main() -> None:
    state, *arguments = sys.argv[1:]
    simulator = street()
    sys.modules["carla"] = as_library(simulator)
    sys.argv[1:] = arguments
    from unghost.cli import main as unghost

    try:
        unghost()
    finally:
        left = {
            "actors": [actor.type_id for actor in simulator.actors.values()],
            "synchronous": simulator.settings.synchronous_mode,
            "managers": list(simulator.managers_synchronous.values()),
            "spawned": len(simulator.spawned),
        }
        Path(state).write_text(json.dumps(left))


if __name__ == "__main__":
    main()
