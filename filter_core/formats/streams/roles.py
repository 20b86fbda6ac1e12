"""The role of each image of a folder, by its name, its pixels and what is beside it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import Final, TypeAlias

from filter_core.formats.reading import last_name
from filter_core.formats.streams.facts import StreamPart
from filter_core.formats.streams.images import DIGITS, USED, Image, stem_of
from filter_core.formats.streams.looks import Look, look_of
from filter_core.formats.words import Role

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


class _Endings:
    """The constant beginnings and endings by which names in one folder differ.

    They are told by frames that have two of them, or one and none: ``7.png`` and
    ``7_gt.png``. Only images whose names say no auxiliary role are asked about.
    """

    def __init__(self, images: Iterable[Image]) -> None:
        self._by_rest: dict[tuple[str, str], dict[str, list[Image]]] = {}
        splits: dict[str, list[tuple[tuple[str, str], str]]] = {}
        by_folder: dict[str, list[Image]] = {}
        for image in images:
            if image.role in (None, "image"):
                folder = image.name.rpartition("/")[0]
                by_folder.setdefault(folder, []).append(image)
        for folder, own_images in by_folder.items():
            if len({DIGITS.sub("#", stem_of(image)) for image in own_images}) == 1:
                continue  # nothing but numbers differs
            for image in own_images:
                stem = stem_of(image)
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

    def _add(self, rest: tuple[str, str], ending: str, image: Image) -> None:
        self._by_rest.setdefault(rest, {}).setdefault(ending, []).append(image)

    def _regular(
        self,
        splits: Sequence[tuple[tuple[str, str], str]],
        frames: Mapping[tuple[str, str], int],
    ) -> list[tuple[tuple[str, str], str]]:
        """The splits by which many frames differ; names of frames are in few."""
        partners = [split for split in splits if len(self._by_rest[split[0]]) > 1]
        counts = [frames[rest[0], ending] for rest, ending in partners]
        most = max(counts, default=0)
        return [
            split
            for split, count in zip(partners, counts, strict=True)
            if 2 * count >= most and (count > 1 or "" in self._by_rest[split[0]])
        ]

    def of(self, image: Image) -> str:
        """The beginnings and endings of an image that are its stream's."""
        return " ".join(ending for _, ending in self._own.get(image.name, ()))

    def partners(self, image: Image) -> Iterator[tuple[str, list[Image]]]:
        """The frame's part of the name, and the images that differ in the ending."""
        for rest, ending in self._own.get(image.name, ()):
            for other, images in self._by_rest[rest].items():
                if other != ending:
                    yield rest[1], images


_SILENT: Final = (
    "neither its name nor its pixels tell what it is, beside an image that is named as "
    "a picture; `files` in recording.yaml says it"
)

_UNCLEAR: Final = (
    "a grey image beside one in colour: depth or a picture? Neither its name nor its "
    "pixels tell; `files` in recording.yaml says it"
)


@dataclass(frozen=True)
class _Stream:
    """Images of one stream, and the looks of some of them.

    Only the names of some images may be known: their files are empty, which says
    nothing about them.
    """

    images: Sequence[Image]
    looks: frozenset[Look]
    has_content: bool

    @property
    def has_colors(self) -> bool:
        """Whether these are pictures, as far as is known, that are not grey."""
        first = self.images[0]
        if first.values is not None:
            return first.role == "image"
        return first.role in (None, "image") and self.looks <= {"photo"}


_MOST_LOOKED_AT: Final = 48
"""Images of a folder that are looked at, unless those of a stream differ."""

_MOST_OF_SCENES: Final = 8
"""Images that are looked at in streams that share their looks."""

_MOST_ONE_BY_ONE: Final = 256
"""Images of a folder that are looked at because those of their stream differ."""

_Key: TypeAlias = tuple[str, ...]

_Outcome: TypeAlias = tuple[Role | None, str]


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


class Roles:
    """What each image of a folder is.

    `images` are in their order; the keys of those that differ from a picture by a
    constant ending are without it.
    """

    def __init__(self, images: Sequence[Image]) -> None:
        self._of_stream: dict[_Key, _Outcome] = {}
        self._of_image: dict[str, _Outcome] = {}
        self.parts: list[StreamPart] = []
        self.notes: list[str] = []
        self._endings = _Endings(images)
        self._left = _MOST_ONE_BY_ONE
        streams = self._streams(images)
        firsts = {stream.images[0].frame for stream in streams}
        pictures = firsts.intersection(
            image.frame for image in images if image.role in (None, "image")
        )
        bases = set(map(last_name, firsts)) if len(streams) > 1 else set()
        by_base: dict[str, list[_Stream]] = {base: [] for base in bases}
        for stream in filter(attrgetter("has_colors"), streams):
            for base in bases.intersection(
                last_name(image.frame) for image in stream.images
            ):
                by_base[base].append(stream)
        for stream in streams:
            first = stream.images[0]
            others = [
                other
                for other in by_base.get(last_name(first.frame), ())
                if other is not stream
            ]
            decided = partial(
                _decided,
                has_partner=first.frame in pictures,
                in_color=bool(others),
                has_named=stream.has_content
                and any(other.images[0].role == "image" for other in others),
            )
            self._decide(stream, decided)
            self.parts += self._parts(stream)
        self.images = [self._without_ending(image) for image in images]

    def of(self, image: Image) -> _Outcome:
        """The role of an image, or None and the reason why it has none."""
        own = self._of_image.get(image.name)
        return own or self._of_stream[self._stream_of(image)]

    def _stream_of(self, image: Image) -> _Key:
        return (*image.stream, self._endings.of(image))

    def _streams(self, images: Iterable[Image]) -> list[_Stream]:
        """The streams of a folder, the largest first."""
        by_stream: dict[_Key, list[Image]] = {}
        for image in images:
            by_stream.setdefault(self._stream_of(image), []).append(image)
        ordered = sorted(by_stream, key=lambda key: len(by_stream[key]), reverse=True)
        kinds = _kinds(key for key, own in by_stream.items() if own[0].values is None)
        by_kind: dict[_Key, list[_Key]] = {}
        for key in filter(kinds.__contains__, ordered):
            by_kind.setdefault(kinds[key], []).append(key)
        looks: dict[_Key, frozenset[Look]] = {}
        left, share = _MOST_LOOKED_AT, max(2, _MOST_LOOKED_AT // max(1, len(by_kind)))
        taken: list[Sequence[Image]] = []
        named: list[Sequence[Image]] = []
        for kind, keys in by_kind.items():
            members = [by_stream[key] for key in keys]
            most = min(left, share, _MOST_OF_SCENES)
            samples = _samples(members, most)
            left -= len(samples)
            seen = (look_of(image.path) for image in samples)
            looks[kind] = frozenset(look for look in seen if look)
            sampled = {image.name for image in samples}
            rest = [
                images
                for images in members
                if not sampled & {each.name for each in images}
            ]
            if samples or not most:
                (taken if samples else named).extend(rest)
        if taken:
            self.notes.append(
                f"{_sum(taken)} were not looked at: they were taken to be what those "
                "in similar folders are, which were looked at"
            )
        if named:
            self.notes.append(
                f"{_sum(named)} were not looked at: their names alone told what they "
                "are; `files` in recording.yaml says it"
            )
        streams = [
            _Stream(
                by_stream[key],
                looks.get(kinds.get(key, key), frozenset()),
                any(map(_has_content, by_stream[key])),
            )
            for key in ordered
        ]
        empty = [stream.images for stream in streams if not stream.has_content]
        silent = [images for images in empty if images[0].role is None]
        if silent and len(streams) > 1:
            self.notes.append(
                f"{_sum(silent)} are empty here: only names told pictures from "
                "segmentations, and theirs say neither; `files` in recording.yaml can"
            )
        return streams

    def _decide(
        self, stream: _Stream, decided: Callable[[Image, Look | None], _Outcome]
    ) -> None:
        """One role for a stream's images, or one for each if its looks disagree on it.

        Then at most `_MOST_ONE_BY_ONE` images are looked at.
        """
        first = stream.images[0]
        if first.values is not None:
            self._of_stream[self._stream_of(first)] = first.role, ""
            return
        outcomes = {decided(first, look) for look in stream.looks or (None,)}
        if len(outcomes) == 1:
            self._of_stream[self._stream_of(first)] = outcomes.pop()
            return
        skipped = []
        for image in stream.images:
            can_look = self._left > 0 and _has_content(image)
            if not can_look:
                skipped.append(image)
            look = look_of(image.path) if can_look else None
            self._left -= can_look
            self._of_image[image.name] = decided(image, look)
        if skipped:
            self.notes.append(
                f"{_sum([skipped])} were not looked at, although others beside them "
                "look different: their names alone told what they are; `files` in "
                "recording.yaml says it"
            )

    def _parts(self, stream: _Stream) -> Iterator[StreamPart]:
        """The images of a stream by their roles, and what told these."""
        by_role: dict[Role | None, list[Image]] = {}
        for image in stream.images:
            by_role.setdefault(self.of(image)[0], []).append(image)
        for role, images in by_role.items():
            looks = {_ROLE_OF.get(look, "image") for look in stream.looks - {"grey"}}
            # A mask is a segmentation by its pixels alone.
            is_described = images[0].values is not None
            told = {
                "name": images[0].role == role and not is_described,
                "pixels": role in looks and not is_described,
                "description": is_described,
            }
            told_by = tuple(word for word, is_so in told.items() if is_so)
            ending = self._endings.of(images[0])
            yield StreamPart(role, images, told_by, ending)

    def _without_ending(self, image: Image) -> Image:
        """The image with the key of the picture from which an ending tells it apart."""
        role, _ = self.of(image)
        if image.role is not None or role not in (*USED, "image"):
            return image
        for rest, partners in self._endings.partners(image):
            roles = {self.of(partner)[0] for partner in partners}
            prefix = image.frame[: len(image.frame) - len(last_name(image.frame))]
            if role == "image" and not roles.isdisjoint(USED):
                return image._replace(frame=f"{prefix}{rest}")
            if role != "image" and "image" in roles:
                key = f"{prefix}{rest}"
                return image._replace(picture=key, frame=key)
        return image


def _samples(streams: Sequence[Sequence[Image]], most: int) -> list[Image]:
    """The images of streams that are looked at: two, or one of each of some streams."""
    if len(streams) == 1:
        (stream,) = streams
        return _with_content(stream, sorted({0, len(stream) // 2})[:most])
    count = min(most, len(streams))
    chosen = (streams[place * len(streams) // count] for place in range(count))
    samples = (_with_content(stream, [len(stream) // 2]) for stream in chosen)
    return [image for images in samples for image in images]


def _with_content(stream: Sequence[Image], places: Sequence[int]) -> list[Image]:
    """The images at some places.

    If any is empty, all are taken at the same shares of the images that are not.
    """
    chosen = [stream[place] for place in places]
    if all(map(_has_content, chosen)):
        return chosen
    there = [image for image in stream if _has_content(image)]
    near = {place * len(there) // len(stream) for place in places}
    return [there[place] for place in sorted(near)] if there else []


def _has_content(image: Image) -> bool:
    try:
        return image.path.stat().st_size > 0
    except OSError:  # said when it is used
        return False


def _sum(streams: Sequence[Sequence[Image]]) -> str:
    """How many images there are, and one of them."""
    return f"{sum(map(len, streams))} images, such as {streams[0][0].name},"


def _decided(
    image: Image,
    look: Look | None,
    *,
    has_partner: bool,
    in_color: bool,
    has_named: bool,
) -> _Outcome:
    """The role of an image, or None and the reason why it has none.

    `look` is that of its stream, or its own. The others say what is beside it: a
    picture that it could belong to, if it is none itself; an image of the same name
    that is not grey; and one of the same name whose path says that it is a picture,
    while files of its own stream have content.
    """
    role = image.role
    if role == "mask":
        return ("segmentation" if look == "segmentation" else "mask"), ""
    if role is not None and role != "image":
        is_picture = look == "photo" or (look is None and image.in_pictures)
        return ("image" if is_picture and not has_partner else role), ""
    if role is None and look == "grey" and in_color:
        return None, _UNCLEAR
    # The losses of a JPEG hide what it is, but few keep anything but pictures in one.
    is_exact = image.name.lower().endswith(".png")
    if role is None and look is None and has_named and is_exact:
        return None, _SILENT
    shown_role = None if look is None else _ROLE_OF.get(look)
    if shown_role is None:
        return "image", ""
    if role is None:
        return shown_role, ""
    return None, (
        f"its name says that it is a picture, its pixels look like "
        f"{_SHOWN[shown_role]}: it is not used; `files` in recording.yaml says what it "
        "is"
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
