"""One frame in one request: a form with the annotation and the files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final
from urllib.parse import quote

from unghost.errors import unexpected
from unghost.outgoing import FileContent, OutgoingFrame
from unghost.reading import MissingKey
from unghost.results import StoredFrame
from unghost.transport import Call, Files, Transport, body_of

# The server goes by the content, so no type is guessed here.
_ANY_TYPE: Final = "application/octet-stream"


def put(
    transport: Transport, dataset_path: str, frame: OutgoingFrame, *, replace: bool
) -> StoredFrame:
    """Store a frame; the answer has the decisions on its boxes."""
    path = f"{dataset_path}/frames/{quote(frame.key, safe='/')}"
    params = {"replace": replace or None}
    call = Call("PUT", path, params=params, files=_form(frame))
    response = transport.send(call)
    body = {**body_of(response), "created": response.status_code == 201}
    try:
        return StoredFrame.read(body)
    except (MissingKey, TypeError, AttributeError) as exc:
        raise unexpected(response, f"cannot be read: {exc}") from exc


def _form(frame: OutgoingFrame) -> Files:
    annotation = json.dumps(dict(frame.annotation)).encode()
    form = {"annotation": ("annotation.json", annotation, "application/json")}
    for name, content in frame.files.items():
        form[name] = (name, _bytes(content), _ANY_TYPE)
    return form


def _bytes(content: FileContent) -> bytes:
    return content if isinstance(content, bytes) else Path(content).read_bytes()
