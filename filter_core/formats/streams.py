"""The images of a folder by role: the camera's pictures, and what goes with them.

Images that differ in the frame's part of their paths only are a *stream*. Its role is
told by names (``seg/``, ``DEPTHCAM_FRONT/``, ``7_semseg.png``, ``rgb7.png``), and by
the looks of a few of its files, where names say nothing or contradict them. Only
pictures become frames. The segmentation, depth and instances whose paths are the same
but for the words of roles belong to them: ``front/seg/7.png`` to ``front/rgb/7.png``.
"""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Final, Literal, NamedTuple, TypeAlias

from filter_core.formats.looks import Look, look_of
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FrameFileNames,
    Unmatched,
    key_of_folders,
    last_name,
    split_name,
    walk,
)

Role: TypeAlias = Literal[
    "image", "segmentation", "instances", "depth", "mask", "ignore_mask", "other"
]
"""What the images of a stream are. ``mask``: either classes or whatever else a mask
marks; ``other``: what no frame has, such as optical flow."""

_WORDS: Final[Mapping[Role, str]] = {
    "other": "optical|opticalflow|optflow|flow|normals|disparity|dvs|lidar|radar|"
    "panoptic|heatmap",
    "ignore_mask": "ignore|ignored",
    "instances": "instances|instance|inst",
    "depth": "depths|depth",
    "segmentation": "segmentations|segmentation|segments|segment|segs|segm|seg|"
    "semantics|semantic|sem",
    "mask": "masks|mask|segmentationclass|segmentationobject",
    "image": "images|image|imgs|img|rgba|rgb|cameras|camera|cam|jpegimages|photos|"
    "photo|colour|color",
}
"""Words in names, the deciding ones first: an instance segmentation has instances."""

_USED: Final[tuple[Role, ...]] = ("segmentation", "depth", "instances")
"""Roles of the images that a frame is given."""

_ALL_WORDS: Final = "|".join(_WORDS.values())
_CONSISTS_OF_WORDS: Final = re.compile(rf"(?:{_ALL_WORDS})+")
_ANY_WORD: Final = re.compile(_ALL_WORDS)
_ONE_OF: Final = {role: re.compile(words) for role, words in _WORDS.items()}
_TOKEN: Final = re.compile(r"[A-Za-z]+|[^A-Za-z]+")
_SEPARATORS: Final = " _-."
_DIGITS: Final = re.compile(r"\d+")


class _Part(NamedTuple):
    """One name of a path, and what its words say.

    Attributes
    ----------
    role : Role or None
    is_pure : bool
        Whether it consists of words of roles alone.
    picture, frame : str
        Without the words of auxiliary roles; without those of all roles.
    """

    role: Role | None
    is_pure: bool
    picture: str
    frame: str


def _part_of(name: str) -> _Part:
    if not _ANY_WORD.search(name.lower()):
        return _Part(None, False, name, name)
    roles: set[Role] = set()
    picture, frame = [], []
    for token in _TOKEN.findall(name):
        said = _roles_of(token.lower())
        roles |= said
        picture.append("" if said - {"image"} else token)
        frame.append("" if said else token)
    role = next((one for one in _WORDS if one in roles), None)
    if role is None:
        return _Part(None, False, name, name)
    texts = (name if role == "image" else _joined(picture), _joined(frame))
    return _Part(role, not texts[1], *texts)


@lru_cache(4096)
def _roles_of(token: str) -> frozenset[Role]:
    """The roles that a token of letters names, if it consists of nothing else."""
    if not _CONSISTS_OF_WORDS.fullmatch(token):
        return frozenset()
    return frozenset(role for role, words in _ONE_OF.items() if words.search(token))


_SEVERAL_SEPARATORS: Final = re.compile(r"([ _.-])[ _.-]+")


def _joined(tokens: Iterable[str]) -> str:
    """Tokens without the separators around those that are left out."""
    return _SEVERAL_SEPARATORS.sub(r"\1", "".join(tokens)).strip(_SEPARATORS)


class _Image(NamedTuple):
    """An image, and what its path says.

    Attributes
    ----------
    name : str
        Relative to the folder in which it was found.
    folder : Path
    role : Role or None
    in_folder, in_pictures : bool
        Whether a folder of its own says the role, and not an ending of the name;
        whether it is in a folder of pictures.
    picture, frame : str
        The key of the picture that it is, or that it belongs to; the same without the
        words of all roles.
    stream : tuple of str
        Equal for all images of a stream.
    """

    name: str
    folder: Path
    role: Role | None
    in_folder: bool
    in_pictures: bool
    picture: str
    frame: str
    stream: tuple[str, str, str]

    @property
    def path(self) -> Path:
        return self.folder / self.name


class _Above(NamedTuple):
    """What the folders above an image say, and the beginnings of its keys."""

    parts: tuple[_Part, ...]
    role: Role | None
    picture: str
    frame: str
    stream: str


@lru_cache(4096)
def _above(folders: str) -> _Above:
    normal = unicodedata.normalize("NFC", folders)
    # carlasimu on Linux writes folders with a backslash in their names.
    names = normal.replace("\\", "/").split("/")
    parts = tuple(_part_of(name) for name in names if name)
    picture, frame = (
        key_of_folders("/".join(filter(None, texts)))
        for texts in ([part.picture for part in parts], [part.frame for part in parts])
    )
    return _Above(parts, _role(parts), picture, frame, _DIGITS.sub("#", folders))


def _image(name: str, folder: Path) -> _Image:
    folders, _, last = name.rpartition("/")
    stem, suffix = split_name(unicodedata.normalize("NFC", last))
    above, own = _above(folders), _part_of(stem)
    if own.is_pure and above.role == "image":  # a picture may be called anything
        own = _Part(None, False, stem, stem)
    role, words = above.role, ""
    if own.role is not None:
        role = _role((*above.parts, own))
        words = _DIGITS.sub("#", stem.replace(own.frame, ""))
    return _Image(
        name,
        folder,
        role,
        any(part.is_pure and part.role == role for part in above.parts),
        above.role == "image",
        f"{above.picture}{own.picture}".rstrip("/"),
        f"{above.frame}{own.frame}".rstrip("/"),
        (above.stream, words, suffix.lower()),
    )


def _role(parts: Sequence[_Part]) -> Role | None:
    """The role that a path says.

    A folder of auxiliary images (``seg/``) says it for all below it (``seg/rgb/``);
    otherwise the last name that says one (``depth_test/images/``).
    """
    said = [part for part in parts if part.role]
    auxiliary = [part for part in said if part.is_pure and part.role != "image"]
    return next((part.role for part in reversed(auxiliary or said)), None)


class Streams:
    """The images of a folder by role.

    Parameters
    ----------
    folder : Path
        Where the pictures are, and what goes with them.
    named : Path, optional
        A folder whose images are the segmentations, whatever they are called; others
        are not used.
    skip : collection of Path
        Folders that are not looked into.
    beside : mapping of str to Path
        Folders elsewhere by the role of their images (`auxiliary_folders`).

    Attributes
    ----------
    images : list of str
        The camera's pictures, relative to the folder.
    """

    def __init__(
        self,
        folder: Path,
        named: Path | None = None,
        skip: Collection[Path] = (),
        beside: Mapping[Role, Path] = MappingProxyType({}),
    ) -> None:
        skipped = [*skip, *beside.values(), *([named] if named else [])]
        images = [_image(name, folder) for name in _names(folder, skipped)]
        self._refused: list[Unmatched] = []
        self._by_role: dict[Role, list[_Image]] = {role: [] for role in _WORDS}
        roles = dict(_with_roles(images))
        for image in images:
            role, why = roles[image.name]
            if role is not None:
                self._by_role[role].append(image)
            else:
                self._refused.append(Unmatched(image.name, why))
        self.images = [image.name for image in self._by_role["image"]]
        elsewhere = dict(beside)
        if named is not None:
            elsewhere["segmentation"] = named
        for role, place in elsewhere.items():
            names = walk(place, IMAGE_SUFFIXES)
            self._by_role[role] = [_image(name, place) for name in names]

    def complete(
        self, frames: Iterable[FrameFileNames], without: str
    ) -> tuple[list[FrameFileNames], tuple[Unmatched, ...]]:
        """The frames with their auxiliary images, and all images that are left over.

        `without` is what an image that is left over lacks, such as ``label file``.
        """
        given = list(frames)
        keys = [_image(one.image or one.label, Path()) for one in given]
        files: list[dict[str, Path]] = [{} for _ in given]
        left_over = list(self._refused)
        for role in (role for role in _USED if self._by_role[role]):
            index = _Index(self._by_role[role], keys)
            for key, own in zip(keys, files, strict=True):
                if (image := index.take(key)) is not None:
                    own[role] = image.path
            left_over += index.left_over(f"no {without} for this {_NOUNS[role]}")
        for role, why in _UNUSED.items():
            left_over += (Unmatched(one.name, why) for one in self._by_role[role])
        pairs = zip(given, files, strict=True)
        completed = [replace(one, files=own) if own else one for one, own in pairs]
        return completed, tuple(left_over)


_NOUNS: Final[Mapping[Role, str]] = {
    "segmentation": "segmentation",
    "depth": "depth image",
    "instances": "instance image",
}

_UNUSED: Final[Mapping[Role, str]] = {
    "mask": "a mask that is not known to be a segmentation is no frame",
    "ignore_mask": "an image of ignored regions belongs to a frame only if a manifest "
    "names it",
    "other": "an image of another sensor is no frame",
}

_UNCLEAR: Final = (
    "a grey image beside one in colour: depth or a picture? Neither its name nor its "
    "pixels tell; a manifest can"
)


def _names(folder: Path, skipped: Collection[Path]) -> Iterator[str]:
    """The images of a folder, also in a folder of auxiliary images that is a link."""
    yield from walk(folder, IMAGE_SUFFIXES, skipped)
    for path in auxiliary_folders(folder).values():
        if path.is_symlink() and path not in skipped:
            names = walk(path, IMAGE_SUFFIXES)
            yield from (f"{path.name}/{name}" for name in names)


def auxiliary_folders(*places: Path, of: str = "") -> dict[Role, Path]:
    """The first folder for each auxiliary role right below one of the places.

    Its name may also have that of the camera, `of`: ``front_seg``.
    """
    folders: dict[Role, Path] = {}
    for place in places:
        for path in sorted(place.iterdir()) if place.is_dir() else ():
            image = _image(f"{path.name}/0.png", place)
            is_ours = image.frame in ("0", f"{of}/0") and path.is_dir()
            if image.role in _USED and is_ours:
                folders.setdefault(image.role, path)
    return folders


@dataclass(frozen=True)
class _Stream:
    """Images of one stream, and the looks of some of them."""

    images: Sequence[_Image]
    looks: frozenset[Look]

    def is_beside(self, other: _Stream) -> bool:
        """Whether the other has pictures of the same names that are not grey."""
        names = {last_name(one.frame) for one in other.images}
        return (
            other.images[0].role in (None, "image")
            and other.looks <= {"photo"}
            and last_name(self.images[0].frame) in names
        )

    def each(self) -> Iterator[tuple[_Image, frozenset[Look]]]:
        """The images with the looks of the stream; if they differ, with their own."""
        for image in self.images:
            if len(self.looks) < 2:
                yield image, self.looks
            else:
                look = look_of(image.path)
                yield image, frozenset({look} if look else ())


_MOST_LOOKED_AT: Final = 48
"""Images of a folder that are looked at, unless those of a stream differ."""


def _looked_at(images: Sequence[_Image]) -> list[_Stream]:
    """The streams of a folder, the largest first."""
    by_stream: dict[tuple[str, str, str], list[_Image]] = {}
    for image in images:
        by_stream.setdefault(image.stream, []).append(image)
    streams, left = [], _MOST_LOOKED_AT
    for stream in sorted(by_stream.values(), key=len, reverse=True):
        places = sorted({0, len(stream) // 2})[:left]
        left -= len(places)
        looks = (look_of(stream[place].path) for place in places)
        streams.append(_Stream(stream, frozenset(look for look in looks if look)))
    return streams


def _with_roles(
    images: Sequence[_Image],
) -> Iterator[tuple[str, tuple[Role | None, str]]]:
    """The name of each image with its role, or with the reason why it has none."""
    streams = _looked_at(images)
    pictures = {one.frame for one in images if one.role in (None, "image")}
    for stream in streams:
        has_partner = stream.images[0].frame in pictures
        has_color = any(stream.is_beside(other) for other in streams)
        for image, looks in stream.each():
            yield image.name, _decided(image, looks, has_partner, has_color)


def _decided(
    image: _Image, looks: Collection[Look], has_partner: bool, has_color: bool
) -> tuple[Role | None, str]:
    """The role of an image, or None and the reason why it has none.

    Parameters
    ----------
    image : _Image
    looks : collection of Look
        Of its stream, or its own: one at most.
    has_partner : bool
        Whether there is a picture that it could belong to, if it is none itself.
    has_color : bool
        Whether there is a picture of the same name that is not grey.
    """
    look, said = next(iter(looks), None), image.role
    if said == "mask":
        return ("segmentation" if look == "segmentation" else "mask"), ""
    if said is not None and said != "image":
        is_picture = look == "photo" or (look is None and image.in_pictures)
        return ("image" if is_picture and not has_partner else said), ""
    if look == "grey" and has_color and said is None:
        return None, _UNCLEAR
    shown_role = None if look is None else _ROLE_OF.get(look)
    if shown_role is None:
        return "image", ""
    if said is None:
        return shown_role, ""
    return None, (
        f"its name says that it is a picture, its pixels look like "
        f"{_SHOWN[shown_role]}: it is not used; a manifest can say what it is"
    )


_ROLE_OF: Final[Mapping[Look, Role]] = {
    "segmentation": "segmentation",
    "instances": "instances",
    "depth": "depth",
}

_SHOWN: Final[Mapping[Role, str]] = {
    "segmentation": "a segmentation",
    "instances": "an instance image",
    "depth": "depth",
}


class _Index:
    """The images of one role, each for the frame that it belongs to.

    Parameters
    ----------
    images : sequence of _Image
    frames : sequence of _Image
        The pictures or labels of all frames.
    """

    def __init__(self, images: Sequence[_Image], frames: Sequence[_Image]) -> None:
        self._unused = {image.name: image for image in images}
        self._same: dict[str, Unmatched] = {}
        # Of several images, those in a folder of their own come first.
        ordered = sorted(images, key=lambda one: not one.in_folder)
        self._by_picture = _grouped((one.picture, one) for one in ordered)
        self._by_frame = _grouped((one.frame, one) for one in ordered)
        self._by_base = _grouped((last_name(one.frame), one) for one in ordered)
        self._frames = Counter(one.frame for one in frames)
        self._bases = Counter(last_name(one.frame) for one in frames)

    def take(self, frame: _Image) -> _Image | None:
        """The image that belongs to a frame."""
        images = self._by_picture.get(frame.picture, [])
        if not images and self._frames[frame.frame] == 1:
            images = self._by_frame.get(frame.frame, [])
        if not images:
            images = self._of_this_base(frame)
        if not images:
            return None
        first, *others = images
        self._unused.pop(first.name, None)
        for other in others:
            if self._unused.pop(other.name, None):
                why = f"same frame as {first.name}, which is used"
                self._same[other.name] = Unmatched(other.name, why)
        return first

    def _of_this_base(self, frame: _Image) -> list[_Image]:
        """Images are often in a flat folder although pictures are not, or the reverse.

        But only a name that occurs once on both sides identifies a frame. Where words
        of folders differ, they may be those of different cameras; one that was
        recognised by its pixels alone may be called anything.
        """
        base = last_name(frame.frame)
        images = self._by_base.get(base, [])
        if self._bases[base] != 1 or len(images) != 1:
            return []
        ends = (f"/{frame.frame}", f"/{images[0].frame}")
        fits = ends[0].endswith(ends[1]) or ends[1].endswith(ends[0])
        return images if fits or images[0].role is None else []

    def left_over(self, why: str) -> list[Unmatched]:
        """Images that belong to no frame, and those of a frame that has another."""
        unused = [Unmatched(one.name, why) for one in self._unused.values()]
        return [*self._same.values(), *unused]


def _grouped(images: Iterable[tuple[str, _Image]]) -> dict[str, list[_Image]]:
    groups: dict[str, list[_Image]] = {}
    for key, image in images:
        groups.setdefault(key, []).append(image)
    return groups
