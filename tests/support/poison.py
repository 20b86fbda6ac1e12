"""Pictures, decisions and exports that kill the process that works on them.

The process dies where the service calls a library: when OpenCV decodes one of the
`poisoned_files`, when SQLAlchemy stores what a run flips, when a zip file is written.
To be laid in processes of the tests' own, before these begin to work. Who stores a
picture decodes it, too: let a process without poison store these files.
"""

from __future__ import annotations

import os
import signal
import time
import zipfile
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from sqlalchemy import Engine, event

from tests.support import frames

FRAMES, DECISIONS, EXPORTS = "frames", "decisions", "exports"
EMPTY = {"boxes": [], "carla_version": "0.9.15"}
"""The annotation of a poisoned frame: raw tags need a version."""
_MARK = b"poison"


def poisoned_files() -> dict[str, bytes]:
    """A frame whose segmentation has a mark behind the end of the PNG.

    It is grey, and so decoded by OpenCV.
    """
    grey = np.zeros((frames.HEIGHT, frames.WIDTH), np.uint8)
    png = cv2.imencode(".png", grey)[1].tobytes()
    return {"image": frames.image(), "segmentation": png + _MARK}


def lay_poison(kind: str = FRAMES) -> None:
    """Let this process die where it would do such a thing."""
    if kind == FRAMES:
        _wrap(cv2, "imdecode", lambda content, *_: content.tobytes().endswith(_MARK))
    elif kind == DECISIONS:
        event.listen(Engine, "before_cursor_execute", _die_of_flips)
    else:
        _wrap(zipfile.ZipFile, "open", lambda _zip, _name, mode="r", *_: mode == "w")


def _wrap(owner: Any, name: str, is_deadly: Callable[..., bool]) -> None:
    call = getattr(owner, name)

    def wrapped(*args: Any, **more: Any) -> Any:
        if is_deadly(*args):
            _die()
        return call(*args, **more)

    setattr(owner, name, wrapped)


def _die_of_flips(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
    if statement.startswith("INSERT INTO flips "):
        _die()


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)  # until the signal is there, nothing more happens


if __name__ == "__main__":
    from app.serve import serve
    from app.settings import Settings

    lay_poison()
    serve(Settings())
