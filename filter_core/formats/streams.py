"""The images of a folder by role: the camera's pictures, and what goes with them.

Images that differ in the frame's part of their paths only are a *stream*. Its role is
told by names (``seg/``, ``DEPTHCAM_FRONT/``, ``7_semseg.png``, ``rgb7.png``), and by
the looks of a few of its files, where names say nothing or contradict them. Only
pictures become frames, or, where there are none, segmentations and instances. The
segmentation, depth and instances whose paths are the same but for the words of roles
belong to a picture: ``front/seg/7.png`` to ``front/rgb/7.png``.
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
    IMAGE_FOLDER_WORDS,
    IMAGE_SUFFIXES,
    FrameFileNames,
    StreamFacts,
    Unmatched,
    frame_key,
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
    "image": f"{'|'.join(IMAGE_FOLDER_WORDS)}|imgs|rgba|rgb|cameras|camera|cam|photos|"
    "photo|colour|color",
}
"""Words in names, the deciding ones first: an instance segmentation has instances."""

_USED: Final[tuple[Role, ...]] = ("segmentation", "depth", "instances")
"""Roles of the images that a frame is given."""

_SHOWING: Final[tuple[Role, ...]] = ("segmentation", "instances")
"""Roles of the images that tell enough of a frame without a picture."""

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
        token_roles = _roles_of(token.lower())
        roles |= token_roles
        picture.append("" if token_roles - {"image"} else token)
        frame.append("" if token_roles else token)
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


def names_that_tell_nothing(names: Iterable[str]) -> list[str]:
    """Images whose paths do not say what they are, beside images of other streams.

    Only their pixels can tell whether they are pictures.
    """
    images = [_image(name, Path()) for name in names]
    silent = [image.name for image in images if image.role is None]
    endings = _Endings(images)
    has_others = len({(*image.stream, endings.of(image)) for image in images}) > 1
    return silent if has_others else []


def _role(parts: Sequence[_Part]) -> Role | None:
    """The role that a path says.

    A folder of auxiliary images (``seg/``) says it for all below it (``seg/rgb/``);
    otherwise the last name that says one (``depth_test/images/``).
    """
    with_role = [part for part in parts if part.role]
    auxiliary = [part for part in with_role if part.is_pure and part.role != "image"]
    return next((part.role for part in reversed(auxiliary or with_role)), None)


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
    facts : tuple of StreamFacts
        The streams of each role, also of those that no frame has.
    notes : tuple of str
        Sentences about images that were not looked at.
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
        roles = _Roles(images)
        self.notes = tuple(roles.notes)
        self._pictures = {image.name: image for image in roles.images}
        for image in roles.images:
            role, why = roles.of[image.name]
            if role is not None:
                self._by_role[role].append(image)
            else:
                self._refused.append(Unmatched(image.name, why))
        self.images = [image.name for image in self._by_role["image"]]
        facts = [one for one in roles.facts if one.role not in beside]
        elsewhere = dict(beside)
        if named is not None:
            elsewhere["segmentation"] = named
            facts = [one for one in facts if one.role != "segmentation"]
        for role, place in elsewhere.items():
            names = walk(place, IMAGE_SUFFIXES)
            own = self._by_role[role] = [_image(name, place) for name in names]
            if own:
                told_by = "description" if place == named else "name"
                example = f"{place.name}/{own[0].name}"
                facts.append(StreamFacts(role, len(own), example, (told_by,)))
        self.facts = tuple(facts)

    def complete(
        self, frames: Iterable[FrameFileNames], without: str
    ) -> tuple[list[FrameFileNames], tuple[Unmatched, ...]]:
        """The frames with their auxiliary images, and all images that are left over.

        `without` is what an image that is left over lacks, such as ``label file``.
        """
        incomplete = list(frames)
        names = (one.image or one.label for one in incomplete)
        keys = [self._pictures.get(name) or _image(name, Path()) for name in names]
        files: list[dict[str, Path]] = [{} for _ in incomplete]
        left_over = list(self._refused)
        for role in (role for role in _USED if self._by_role[role]):
            index = _Index(self._by_role[role], keys)
            for key, own in zip(keys, files, strict=True):
                if (image := index.take(key)) is not None:
                    own[role] = image.path
            left_over += index.left_over(f"no {without} for this {_NOUNS[role]}")
        for role, why in _UNUSED.items():
            left_over += (Unmatched(one.name, why) for one in self._by_role[role])
        pairs = zip(incomplete, files, strict=True)
        completed = [replace(one, files=own) if own else one for one, own in pairs]
        return completed, tuple(left_over)

    def without_pictures(self) -> list[FrameFileNames]:
        """A frame for each segmentation and instance image, if there is no picture.

        Beside pictures they belong to one of these, or to no frame. Its key is that of
        the picture; its label is the name of the image.
        """
        if self.images or self._refused:
            return []
        firsts: dict[str, str] = {}
        for role in _SHOWING:
            for image in self._by_role[role]:
                firsts.setdefault(image.picture, image.name)
        return [
            FrameFileNames(picture or frame_key(name), name)
            for picture, name in firsts.items()
        ]


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

_SILENT: Final = (
    "neither its name nor its pixels tell what it is, beside an image that is named as "
    "a picture; a manifest can"
)

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


_ENDS: Final = re.compile(r"[ _.-]+")
_LETTERS_BEFORE: Final = re.compile(r"([A-Za-z]+)(\d.*)", re.DOTALL)
_LETTERS_BEHIND: Final = re.compile(r"(.*\d)([A-Za-z]+)", re.DOTALL)
_MOST_PARTS: Final = 8


def _splits(stem: str) -> Iterator[tuple[str, str]]:
    """What a name may consist of: the frame's part, and a beginning or an ending.

    ``7_gt`` is ``7`` and ``gt``; ``gt_front_7`` also ``front_7`` and ``gt``.
    """
    parts = [part for part in _ENDS.split(stem) if part]
    words = [not part.isdigit() for part in parts]
    count = len(parts) if 1 < len(parts) <= _MOST_PARTS else 0
    for end in range(1, count):
        if all(words[:end]):
            yield "_".join(parts[end:]), f"{'_'.join(parts[:end])}_"
        if all(words[end:]):
            yield "_".join(parts[:end]), f"_{'_'.join(parts[end:])}"
        if end > 1 and words[end - 1]:
            rest = [*parts[: end - 1], *parts[end:]]
            yield "_".join(rest), f"_{parts[end - 1]}_"
    if match := _LETTERS_BEFORE.fullmatch(stem):
        yield match[2], f"{match[1]}_"
    if match := _LETTERS_BEHIND.fullmatch(stem):
        yield match[1], f"_{match[2]}"


def _stems(images: Iterable[_Image]) -> dict[str, list[tuple[str, _Image]]]:
    """The names of images that may be pictures, without suffixes, by their folders."""
    stems: dict[str, list[tuple[str, _Image]]] = {}
    for image in images:
        if image.role in (None, "image"):
            folder, _, last = image.name.rpartition("/")
            stem = split_name(unicodedata.normalize("NFC", last))[0]
            stems.setdefault(folder, []).append((stem, image))
    return stems


class _Endings:
    """The constant beginnings and endings by which names in one folder differ.

    They are told by frames that have two of them, or one and none: ``7.png`` and
    ``7_gt.png``. Only images whose names say no auxiliary role are asked about.
    """

    def __init__(self, images: Iterable[_Image]) -> None:
        self._by_rest: dict[tuple[str, str], dict[str, list[_Image]]] = {}
        splits: dict[str, list[tuple[tuple[str, str], str]]] = {}
        for folder, stems in _stems(images).items():
            if len({_DIGITS.sub("#", stem) for stem, _ in stems}) == 1:
                continue  # nothing but numbers differs
            for stem, image in stems:
                whole = "_".join(filter(None, _ENDS.split(stem)))
                self._add((folder, whole), "", image)
                own = splits[image.name] = []
                for rest, ending in dict.fromkeys(_splits(stem)):
                    own.append(((folder, rest), ending))
                    self._add((folder, rest), ending, image)
        frames = Counter(
            (rest[0], ending)
            for rest, endings in self._by_rest.items()
            if len(endings) > 1
            for ending in endings
        )
        self._own = {
            name: self._regular(own, frames) for name, own in splits.items() if own
        }

    def _add(self, rest: tuple[str, str], ending: str, image: _Image) -> None:
        self._by_rest.setdefault(rest, {}).setdefault(ending, []).append(image)

    def _regular(
        self,
        splits: Sequence[tuple[tuple[str, str], str]],
        frames: Mapping[tuple[str, str], int],
    ) -> list[tuple[tuple[str, str], str]]:
        """The splits by which many frames differ; names of frames are in few."""
        partners = [one for one in splits if len(self._by_rest[one[0]]) > 1]
        counts = [frames[rest[0], ending] for rest, ending in partners]
        most = max(counts, default=0)
        return [
            split
            for split, count in zip(partners, counts, strict=True)
            if 2 * count >= most and (count > 1 or "" in self._by_rest[split[0]])
        ]

    def of(self, image: _Image) -> str:
        """The beginnings and endings of an image that are its stream's."""
        return " ".join(ending for _, ending in self._own.get(image.name, ()))

    def partners(self, image: _Image) -> Iterator[tuple[str, list[_Image]]]:
        """The frame's part of the name, and the images that differ in the ending."""
        for rest, ending in self._own.get(image.name, ()):
            for other, images in self._by_rest[rest].items():
                if other != ending:
                    yield rest[1], images


@dataclass(frozen=True)
class _Stream:
    """Images of one stream, and the looks of some of them."""

    images: Sequence[_Image]
    looks: frozenset[Look]

    @property
    def has_colors(self) -> bool:
        """Whether these are pictures, as far as is known, that are not grey."""
        return self.images[0].role in (None, "image") and self.looks <= {"photo"}


_MOST_LOOKED_AT: Final = 48
"""Images of a folder that are looked at, unless those of a stream differ."""

_MOST_OF_SCENES: Final = 8
"""Images that are looked at in streams that share their looks."""

_MOST_ONE_BY_ONE: Final = 256
"""Images of a folder that are looked at because those of their stream differ."""

_Key: TypeAlias = tuple[str, ...]


def _kinds(streams: Iterable[_Key]) -> dict[_Key, _Key]:
    """Streams by those with which they share their looks, if there are many.

    Folders on the level that has the most different names are scenes, such as the
    first of ``town/pic/`` and ``village/gt/``: the images below are taken to look
    alike if their other folders and the beginnings and endings of their names are the
    same.
    """
    kinds = {stream: (*stream[0].split("/"), *stream[1:]) for stream in streams}
    while 2 * len(set(kinds.values())) > _MOST_LOOKED_AT:
        names: dict[tuple[int, int], set[str]] = {}
        for kind in kinds.values():
            for level, name in enumerate(kind[:-3]):
                names.setdefault((len(kind), level), set()).add(name)
        depth, level = max(names, key=lambda each: len(names[each]))
        if len(names[depth, level]) < 2:
            break
        for stream, kind in kinds.items():
            if len(kind) == depth:
                kinds[stream] = (*kind[:level], "*", *kind[level + 1 :])
    return kinds


class _Roles:
    """What each image of a folder is.

    Attributes
    ----------
    of : dict of str to (Role or None, str)
        By the name of an image: its role, or the reason why it has none.
    images : list of _Image
        In their order; the keys of those that differ from a picture by a constant
        ending are without it.
    facts : list of StreamFacts
    notes : list of str
    """

    def __init__(self, images: Sequence[_Image]) -> None:
        self.of: dict[str, tuple[Role | None, str]] = {}
        self.facts: list[StreamFacts] = []
        self.notes: list[str] = []
        self._endings = _Endings(images)
        self._left = _MOST_ONE_BY_ONE
        streams = self._streams(images)
        pictures = {one.frame for one in images if one.role in (None, "image")}
        by_base: dict[str, list[_Stream]] = {}
        for stream in streams:
            if stream.has_colors:
                for base in {last_name(one.frame) for one in stream.images}:
                    by_base.setdefault(base, []).append(stream)
        for stream in streams:
            first = stream.images[0]
            others = [
                other
                for other in by_base.get(last_name(first.frame), ())
                if other is not stream
            ]
            beside = _Beside(
                first.frame in pictures,
                bool(others),
                any(other.images[0].role == "image" for other in others),
            )
            self._decide(stream, beside)
            self.facts += self._facts(stream)
        self.images = [self._without_ending(image) for image in images]

    def _streams(self, images: Iterable[_Image]) -> list[_Stream]:
        """The streams of a folder, the largest first."""
        by_stream: dict[_Key, list[_Image]] = {}
        for image in images:
            stream = (*image.stream, self._endings.of(image))
            by_stream.setdefault(stream, []).append(image)
        kinds = _kinds(by_stream)
        by_kind: dict[_Key, list[_Key]] = {}
        ordered = sorted(by_stream, key=lambda key: len(by_stream[key]), reverse=True)
        for key in ordered:
            by_kind.setdefault(kinds[key], []).append(key)
        looks: dict[_Key, frozenset[Look]] = {}
        left, share = _MOST_LOOKED_AT, max(2, _MOST_LOOKED_AT // max(1, len(by_kind)))
        taken: list[Sequence[_Image]] = []
        named: list[Sequence[_Image]] = []
        for kind, keys in by_kind.items():
            members = [by_stream[key] for key in keys]
            samples = _samples(members, min(left, share, _MOST_OF_SCENES))
            left -= len(samples)
            seen = (look_of(image.path) for image in samples)
            looks[kind] = frozenset(look for look in seen if look)
            sampled = {image.name for image in samples}
            rest = [one for one in members if not sampled & {each.name for each in one}]
            (taken if samples else named).extend(rest)
        if taken:
            self.notes.append(
                f"{_sum(taken)} were not looked at: they were taken to be what those "
                "in similar folders are, which were looked at"
            )
        if named:
            self.notes.append(
                f"{_sum(named)} were not looked at: their names alone told what they "
                "are; a manifest can say it"
            )
        return [_Stream(by_stream[key], looks[kinds[key]]) for key in ordered]

    def _decide(self, stream: _Stream, beside: _Beside) -> None:
        """The roles of a stream's images; if its looks disagree, by looking at each."""
        first = stream.images[0]
        outcomes = {_decided(first, look, beside) for look in stream.looks or (None,)}
        skipped = []
        for image in stream.images:
            outcome = next(iter(outcomes))
            if len(outcomes) > 1:
                look = look_of(image.path) if self._left > 0 else None
                if self._left <= 0:
                    skipped.append(image)
                self._left -= 1
                outcome = _decided(image, look, beside)
            self.of[image.name] = outcome
        if skipped:
            self.notes.append(
                f"{_sum([skipped])} were not looked at, although others beside them "
                "look different: their names alone told what they are; a manifest can "
                "say it"
            )

    def _facts(self, stream: _Stream) -> Iterator[StreamFacts]:
        """The images of a stream by their roles, and what told these."""
        by_role: dict[Role, list[_Image]] = {}
        for image in stream.images:
            role, _ = self.of[image.name]
            if role is not None:
                by_role.setdefault(role, []).append(image)
        for role, images in by_role.items():
            looks = {_ROLE_OF.get(look, "image") for look in stream.looks - {"grey"}}
            # A mask is a segmentation by its pixels alone.
            told = {"name": images[0].role == role, "pixels": role in looks}
            told_by = tuple(word for word, is_so in told.items() if is_so)
            yield StreamFacts(role, len(images), images[0].name, told_by)

    def _without_ending(self, image: _Image) -> _Image:
        """The image with the key of the picture from which an ending tells it apart."""
        role, _ = self.of[image.name]
        if image.role is not None or role not in (*_USED, "image"):
            return image
        for rest, partners in self._endings.partners(image):
            roles = {self.of[partner.name][0] for partner in partners}
            prefix = image.frame[: len(image.frame) - len(last_name(image.frame))]
            if role == "image" and not roles.isdisjoint(_USED):
                return image._replace(frame=f"{prefix}{rest}")
            if role != "image" and "image" in roles:
                key = f"{prefix}{rest}"
                return image._replace(picture=key, frame=key)
        return image


def _samples(streams: Sequence[Sequence[_Image]], most: int) -> list[_Image]:
    """The images of streams that are looked at: two, or one of each of some streams."""
    if len(streams) == 1:
        (stream,) = streams
        return [stream[place] for place in sorted({0, len(stream) // 2})[:most]]
    count = min(most, len(streams))
    chosen = (streams[place * len(streams) // count] for place in range(count))
    return [stream[len(stream) // 2] for stream in chosen]


def _sum(streams: Sequence[Sequence[_Image]]) -> str:
    """How many images there are, and one of them."""
    return f"{sum(map(len, streams))} images, such as {streams[0][0].name},"


class _Beside(NamedTuple):
    """What is beside an image.

    Attributes
    ----------
    partner : bool
        A picture that it could belong to, if it is none itself.
    in_color : bool
        A picture of the same name that is not grey.
    named : bool
        A picture of the same name whose path says that it is one.
    """

    partner: bool
    in_color: bool
    named: bool


def _decided(
    image: _Image, look: Look | None, beside: _Beside
) -> tuple[Role | None, str]:
    """The role of an image, or None and the reason why it has none.

    `look` is that of its stream, or its own.
    """
    role = image.role
    if role == "mask":
        return ("segmentation" if look == "segmentation" else "mask"), ""
    if role is not None and role != "image":
        is_picture = look == "photo" or (look is None and image.in_pictures)
        return ("image" if is_picture and not beside.partner else role), ""
    if role is None and look == "grey" and beside.in_color:
        return None, _UNCLEAR
    # The losses of a JPEG hide what it is, but few keep anything but pictures in one.
    is_exact = image.name.lower().endswith(".png") and image.path.stat().st_size
    if role is None and look is None and beside.named and is_exact:
        return None, _SILENT
    shown_role = None if look is None else _ROLE_OF.get(look)
    if shown_role is None:
        return "image", ""
    if role is None:
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
        nameless = [one for one in images if one.role is None]
        self._by_place = _grouped(
            (place, one) for one in nameless for place in _places(one)
        )
        near = frames if nameless else ()
        self._places = Counter(place for one in near for place in _places(one))

    def take(self, frame: _Image) -> _Image | None:
        """The image that belongs to a frame."""
        images = self._by_picture.get(frame.picture, [])
        if not images and self._frames[frame.frame] == 1:
            images = self._by_frame.get(frame.frame, [])
        if not images:
            images = self._of_this_base(frame) or self._in_folder_beside(frame)
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

    def _in_folder_beside(self, frame: _Image) -> list[_Image]:
        """One recognised by its pixels, if one folder's name is all that differs.

        ``town/gt/7.png`` belongs to ``town/pic/7.png`` unless another picture or
        another such image is as near.
        """
        if not self._by_place:
            return []
        near = [
            image
            for place in _places(frame)
            if self._places[place] == 1
            for image in self._by_place.get(place, ())
        ]
        return near if len(near) == 1 else []

    def left_over(self, why: str) -> list[Unmatched]:
        """Images that belong to no frame, and those of a frame that has another."""
        unused = [Unmatched(one.name, why) for one in self._unused.values()]
        return [*self._same.values(), *unused]


def _places(image: _Image) -> Iterator[str]:
    """The path of an image without one of the names of its folders each."""
    *folders, base = image.frame.split("/")
    for level in range(len(folders)):
        yield "/".join((*folders[:level], "*", *folders[level + 1 :], base))


def _grouped(images: Iterable[tuple[str, _Image]]) -> dict[str, list[_Image]]:
    groups: dict[str, list[_Image]] = {}
    for key, image in images:
        groups.setdefault(key, []).append(image)
    return groups
