"""What the path of an image says: its role, its picture and its stream."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

from filter_core.formats.reading import key_of_folders, last_name, split_name
from filter_core.formats.tables.patterns import Values
from filter_core.formats.words import Part, Role, part_of

USED: Final[tuple[Role, ...]] = ("segmentation", "depth", "instances")
"""Roles of the images that a frame is given."""

DIGITS: Final = re.compile(r"\d+")


class Image(NamedTuple):
    """An image, and what its path says.

    Attributes
    ----------
    name : str
        Relative to the folder in which it was found.
    in_folder, in_pictures : bool
        Whether a folder of its own says the role, and not an ending of the name;
        whether it is in a folder of pictures.
    picture, frame : str
        The key of the picture that it is, or that it belongs to; the same without the
        words of all roles.
    stream : tuple of str
        Equal for all images of a stream.
    in_words : bool
        Whether the file's own name says the role.
    place : str
        As `frame`, with the folders of its path, where a description gives `frame`.
    values : mapping of str to str, or None
        What the names in its pattern stand for, if a description says the role.
    """

    name: str
    folder: Path
    role: Role | None
    in_folder: bool
    in_pictures: bool
    picture: str
    frame: str
    stream: tuple[str, ...]
    in_words: bool
    place: str = ""
    values: Values | None = None

    @property
    def path(self) -> Path:
        return self.folder / self.name


@lru_cache(4096)
def _above(folders: str) -> tuple[tuple[Part, ...], Part, str]:
    """What the folders above an image say: each, all together, and of its stream."""
    normal = unicodedata.normalize("NFC", folders)
    # carlasimu on Linux writes folders with a backslash in their names.
    names = normal.replace("\\", "/").split("/")
    parts = tuple(part_of(name) for name in names if name)
    picture, frame = (
        key_of_folders("/".join(filter(None, texts)))
        for texts in ([part.picture for part in parts], [part.frame for part in parts])
    )
    together = Part(_role(parts), False, picture, frame)
    return parts, together, DIGITS.sub("#", folders)


def image_at(name: str, folder: Path) -> Image:
    folders, _, last = name.rpartition("/")
    stem, suffix = split_name(unicodedata.normalize("NFC", last))
    parts, above, stream = _above(folders)
    own = part_of(stem)
    if own.is_pure and above.role == "image":  # a picture may be called anything
        own = Part(None, False, stem, stem)
    role, words = above.role, ""
    if own.role is not None:
        role = _role((*parts, own))
        words = DIGITS.sub("#", stem.replace(own.frame, ""))
    picture = f"{above.picture}{own.picture}".rstrip("/")
    frame = f"{above.frame}{own.frame}".rstrip("/")
    return Image(
        name,
        folder,
        role,
        any(part.is_pure and part.role == role for part in parts),
        above.role == "image",
        picture,
        picture if frame == picture else frame,
        _stream_key(stream, words, suffix.lower()),
        own.role is not None,
    )


@lru_cache(4096)
def _stream_key(*parts: str) -> tuple[str, ...]:
    """The same tuple for all images of a stream, which may be a million."""
    return parts


def _role(parts: Sequence[Part]) -> Role | None:
    """The role that a path says.

    A folder of auxiliary images (``seg/``) says it for all below it (``seg/rgb/``);
    otherwise the last name that says one (``depth_test/images/``).
    """
    with_role = [part for part in parts if part.role]
    auxiliary = [part for part in with_role if part.is_pure and part.role != "image"]
    return next((part.role for part in reversed(auxiliary or with_role)), None)


def stem_of(image: Image) -> str:
    """The name of an image without its suffix."""
    return split_name(unicodedata.normalize("NFC", last_name(image.name)))[0]
