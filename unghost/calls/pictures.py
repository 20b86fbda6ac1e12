"""Pictures that the server draws: thumbnails, overlays, crops of boxes."""

from __future__ import annotations

from unghost.calls.base import Calls
from unghost.transport import API, Call


class PictureCalls(Calls):
    """Methods that return an encoded image."""

    def thumbnail(self, frame_id: int) -> bytes:
        """A frame's image, small, as JPEG."""
        return self._picture(f"{API}/frames/{frame_id}/thumbnail")

    def overlay(self, frame_id: int, **options: object) -> bytes:
        """A frame with its boxes drawn; options `boxes`, `layer` and `edges`."""
        return self._picture(f"{API}/frames/{frame_id}/overlay", **options)

    def crop(self, box_id: int, **options: object) -> bytes:
        """The part of the image around a box; options `pad`, `layer` and `height`."""
        return self._picture(f"{API}/boxes/{box_id}/crop", **options)

    def _picture(self, path: str, **options: object) -> bytes:
        return self._transport.send(Call("GET", path, params=options)).content
