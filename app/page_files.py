"""The page's files as answers: types, entity tags, and the policy they run under."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from app.errors import NotFound

# Not from the machine's own table: on Windows it may call JavaScript plain text.
MEDIA_TYPES: Final = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".ico": "image/x-icon",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".mjs": "text/javascript; charset=utf-8",
    ".png": "image/png",
    ".svg": "image/svg+xml",
    ".txt": "text/plain; charset=utf-8",
    ".webmanifest": "application/manifest+json",
    ".woff2": "font/woff2",
}
_INLINE_MAP: Final = re.compile(
    rb"<script[^>]*\btype=[\"']importmap[\"'][^>]*>(.*?)</script>", re.DOTALL
)


@dataclass(frozen=True)
class PageFile:
    """One file of the page."""

    content: bytes
    media_type: str
    etag: str


def page_file(folder: Path, name: str) -> PageFile:
    """A file below the folder.

    Raises
    ------
    NotFound
        There is none, it is of no known type, or it lies elsewhere.
    """
    try:
        path = (folder / name).resolve()
        found = path.is_relative_to(folder.resolve()) and path.is_file()
        changed = path.stat().st_mtime_ns if found else 0
    except (OSError, ValueError):  # a NUL, or a name that is too long
        found = False
    if not found or path.suffix not in MEDIA_TYPES:
        raise NotFound("file", name)
    return _read(path, changed)


@lru_cache(maxsize=512)
def _read(path: Path, _changed: int) -> PageFile:
    content = path.read_bytes()
    etag = f'"{hashlib.sha256(content).hexdigest()[:32]}"'
    return PageFile(content, MEDIA_TYPES[path.suffix], etag)


def content_security_policy(index: Path) -> str:
    """The strict policy: own files only, and just the import map that is in the page.

    Without the page (an API-only installation) there is no map to allow.
    """
    page = index.read_bytes() if index.is_file() else b""
    maps = (hashlib.sha256(text).digest() for text in _INLINE_MAP.findall(page))
    hashes = "".join(f" 'sha256-{base64.b64encode(d).decode()}'" for d in maps)
    return (
        "default-src 'none'; "
        f"script-src 'self'{hashes}; "
        "style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
        "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
