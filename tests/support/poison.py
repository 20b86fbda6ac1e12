"""Makes a process kill itself when it works on certain pictures or exports.

It dies where the service calls a library: when OpenCV decodes one of the
`poisoned_files`, or when a zip file is written. Call `lay_poison` in a process of the
test before it begins to work. Storing a picture decodes it as well, so let a process
without poison store these files.
"""

import os
import signal
import time
import zipfile
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from tests.support import frames

FRAMES, EXPORTS = "frames", "exports"
EMPTY = {"boxes": [], "carla_version": "0.9.15"}
"""The annotation of a poisoned frame; raw tags are only read with a version."""
_MARK = b"poison"


def poisoned_files() -> dict[str, bytes]:
    """The files of a frame whose segmentation ends with a mark, after the PNG's end.

    The segmentation is grey, because OpenCV decodes grey images.
    """
    grey = np.zeros((frames.HEIGHT, frames.WIDTH), np.uint8)
    png = cv2.imencode(".png", grey)[1].tobytes()
    return {"image": frames.image(), "segmentation": png + _MARK}


def lay_poison(kind: str = FRAMES) -> None:
    """Let this process kill itself when it does work of this kind."""
    if kind == FRAMES:
        _wrap(cv2, "imdecode", lambda content, *_: content.tobytes().endswith(_MARK))
    else:
        _wrap(zipfile.ZipFile, "open", lambda _zip, _name, mode="r", *_: mode == "w")


def _wrap(owner: Any, name: str, is_deadly: Callable[..., bool]) -> None:
    call = getattr(owner, name)

    def wrapped(*args: Any, **more: Any) -> Any:
        if is_deadly(*args):
            _die()
        return call(*args, **more)

    setattr(owner, name, wrapped)


def _die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)  # so that nothing more happens before the signal arrives


if __name__ == "__main__":
    from app.serve import serve
    from app.settings import Settings

    lay_poison()
    serve(Settings())
