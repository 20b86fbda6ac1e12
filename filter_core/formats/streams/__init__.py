"""The images of a folder by role: the camera's pictures, and what goes with them.

Images that differ in the frame's part of their paths only are a *stream*. Its role is
told by names (``seg/``, ``DEPTHCAM_FRONT/``, ``7_semseg.png``, ``rgb7.png``), and by
the looks of a few of its files, where names say nothing or contradict them. Only
pictures become frames, or, where there are none, segmentations and instances. The
segmentation, depth and instances whose paths are the same but for the words of roles
belong to a picture: ``front/seg/7.png`` to ``front/rgb/7.png``. Where a description has
patterns of files, these say the role, whatever names and pixels say.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Final

from filter_core.errors import LayoutError
from filter_core.formats.matching import (
    FileIndex,
    FrameFileNames,
    FrameNames,
    frame_of,
    named_images,
    with_keys,
)
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    FrameSet,
    StreamFacts,
    Unmatched,
    frame_key,
    walk,
)
from filter_core.formats.recording import RecordingDescription
from filter_core.formats.streams.facts import StreamPart, facts_of, streams_of
from filter_core.formats.streams.images import USED, Image, image_at
from filter_core.formats.streams.index import (
    SAME_FRAME,
    DescribedFiles,
    DescribedIndex,
    ImageIndex,
)
from filter_core.formats.streams.roles import Roles
from filter_core.formats.tables.patterns import MAP, FilePatterns, Values
from filter_core.formats.words import ROLE_WORDS, Role

_SHOWING: Final[tuple[Role, ...]] = ("segmentation", "instances")
"""Roles of the images that tell enough of a frame without a picture."""


class Streams:
    """The images of a folder by role.

    Parameters
    ----------
    folder : Path
        Where the pictures are, and what goes with them.
    description : RecordingDescription, optional
        Its ``segmentation.folder`` has the segmentations, whatever they are called;
        others are not used. Images that match a pattern of its ``files`` have the role
        of the pattern; those of ``ignore`` are left out.
    root : Path, optional
        The folder of the recording, to which patterns are relative. Default: `folder`.
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
        description: RecordingDescription | None = None,
        *,
        root: Path | None = None,
        skip: Collection[Path] = (),
        beside: Mapping[Role, Path] = MappingProxyType({}),
    ) -> None:
        description = description or RecordingDescription()
        named, files = description.segmentation, description.files
        if named is not None and "segmentation" in files.roles:
            raise LayoutError(
                "expected either segmentation.folder or files.segmentation, found both"
            )
        described = self._described = DescribedFiles(root or folder, folder, files)
        skipped = [*skip, *beside.values(), *([named] if named else [])]
        names = described.others(_names(folder, skipped), folder)
        images = [image_at(name, folder) for name in names]
        self._refused: list[Unmatched] = []
        self._by_role: dict[Role, list[Image]] = {role: [] for role in ROLE_WORDS}
        all_images = [*images, *described.of_role.get("image", ())]
        roles = Roles(all_images)
        self.notes = tuple(roles.notes)
        self._pictures = {
            image.name: image
            for image, as_named in zip(roles.images, all_images, strict=True)
            if image.values or image is not as_named
        }
        for image in roles.images:
            role, why = roles.of(image)
            if role is not None:
                self._by_role[role].append(image)
            else:
                self._refused.append(Unmatched(image.name, why))
        self.images = [image.name for image in self._by_role.pop("image")]
        elsewhere = dict(beside)
        if named is not None:
            elsewhere["segmentation"] = named
        facts = [*facts_of(roles.parts, folder, root or folder)]
        facts = [fact for fact in facts if fact.role not in elsewhere]
        for role, place in elsewhere.items():
            names = described.others(walk(place, IMAGE_SUFFIXES), place)
            own = self._by_role[role] = [image_at(name, place) for name in names]
            told_by = "description" if place == named else "name"
            parts = [StreamPart(role, images, (told_by,)) for images in streams_of(own)]
            facts += facts_of(parts, place, root or folder)
        self.facts = (
            *facts,
            *(
                StreamFacts(
                    role,
                    len(own),
                    own[0].name,
                    ("description",),
                    files.roles[role].text,
                )
                for role, own in described.of_role.items()
                if role != "image"
            ),
        )

    def values_of(self, image: str | None) -> Values:
        """What the names in the pattern of a picture stand for in its path."""
        picture = self._pictures.get(image or "")
        return (picture.values if picture else None) or {}

    def complete(
        self, frames: Iterable[FrameFileNames], without: str
    ) -> tuple[FrameNames, tuple[Unmatched, ...]]:
        """The frames with their auxiliary images, and all images that are left over.

        `without` is what an image that is left over lacks, such as ``label file``.
        """
        incomplete = frames if isinstance(frames, FrameNames) else FrameNames(frames)
        described = [role for role in self._described.of_role if role != "image"]
        used = [role for role in USED if self._by_role[role]]
        keys: list[Image] = []
        if used or described or self._pictures:
            names = (frame.image or frame.label for frame in incomplete)
            keys = [
                self._pictures.get(name) or image_at(name, Path()) for name in names
            ]
        has_maps = any(key.values and MAP in key.values for key in keys)
        # Those that a description names are taken before those that it does not.
        indices: dict[str, list[DescribedIndex | ImageIndex]] = {
            role: [
                *self._described.indices(role, keys),
                *([ImageIndex(self._by_role[role], keys)] if role in used else []),
            ]
            for role in dict.fromkeys((*used, *described))
        }
        same: dict[str, list[Unmatched]] = {role: [] for role in indices}

        def with_files(frame: FrameFileNames, key: Image) -> FrameFileNames:
            files: dict[str, Path] = {}
            for role, own in indices.items():
                taken = [image for index in own if (image := index.take(key))]
                if taken:
                    files[role] = taken[0].path
                same[role] += (
                    Unmatched(image.name, SAME_FRAME.format(taken[0].name))
                    for image in taken[1:]
                )
            town = (key.values or {}).get(MAP) if has_maps else frame.map
            return replace(frame, files=files, map=town)

        completed = incomplete
        if keys:
            completed = FrameNames(map(with_files, incomplete, keys))
        left_over = list(self._refused)
        for role, own in indices.items():
            why = f"no {without} for this {_NOUNS[role]}"
            left_over += same[role]
            left_over += (file for each in own for file in each.left_over(why))
        for role, why in _UNUSED.items():
            left_over += (Unmatched(image.name, why) for image in self._by_role[role])
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
            for image in (*self._described.of_role.get(role, ()), *self._by_role[role]):
                firsts.setdefault(image.picture, image.name)
        return [
            FrameFileNames(picture or frame_key(name), name)
            for picture, name in firsts.items()
        ]


_NOUNS: Final[Mapping[str, str]] = {
    "segmentation": "segmentation",
    "depth": "depth image",
    "instances": "instance image",
    "lidar": "point file",
    "radar": "radar file",
    "ignore_mask": "image of ignored regions",
}

_UNUSED: Final[Mapping[Role, str]] = {
    "mask": "a mask that is not known to be a segmentation is no frame",
    "ignore_mask": "an image of ignored regions belongs to a frame only if a manifest "
    "names it",
    "other": "an image of another sensor is no frame",
}


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
            image = image_at(f"{path.name}/0.png", place)
            is_ours = image.frame in ("0", f"{of}/0") and path.is_dir()
            if image.role in USED and is_ours:
                folders.setdefault(image.role, path)
    return folders


def listing_files(
    root: Path,
    options: RecordingDescription,
    files_in: Callable[[Path, FilePatterns], list[Path]],
    expected: str,
) -> list[Path]:
    """The files that list many frames: the one that is described, or those of a folder.

    `files_in` gives those of this format in a folder, without the files that patterns
    ignore; `expected` says what such a file is, for errors. Raises `LayoutError`: there
    is none, or what ``boxes.labels`` names is no file.
    """
    labels = options.labels
    if labels is None:
        paths = files_in(root, options.files)
        if not paths:
            raise LayoutError(f"expected {expected}, found none")
        return paths
    if not labels.is_file():
        raise LayoutError(
            f"boxes.labels: expected {expected}, found {labels.name}, which is no file"
        )
    return [labels]


def listed_frames(
    folder: Path,
    description: RecordingDescription,
    names: Sequence[tuple[str | None, str]],
    noun: str,
) -> FrameSet:
    """The frames that a file lists by the names of their images in a folder.

    They are in its order, and without their annotations; a key that occurs twice is a
    problem of its frames. The layout has no name yet.

    `names` are as for `named_images`; `noun` is what lists the frames, for messages
    about images that are not listed.
    """
    streams = Streams(folder, description)
    images = FileIndex(streams.images)
    files, left_over = streams.complete(named_images(names, images), noun)
    with_own = with_keys(folder, files, ordered=False)
    seen = Counter(frame.key for frame in with_own)
    frames = [
        replace(
            frame_of(frame, folder),
            label=None,
            problem=LayoutError(
                f"{frame.key}: expected one {noun} for each image, "
                f"found {seen[frame.key]}"
            )
            if seen[frame.key] > 1
            else None,
        )
        for frame in with_own
    ]
    unmatched = (*images.left_over(f"no {noun} lists this image"), *left_over)
    return FrameSet(
        layout="",
        frames=lambda: iter(frames),
        count=len(frames),
        unmatched=unmatched,
        notes=lambda: streams.notes,
        streams=streams.facts,
    )
