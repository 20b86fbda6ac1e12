"""Which image of a role belongs to which frame, by paths or by a description."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

from filter_core.formats.matching import PlacesByKey
from filter_core.formats.reading import (
    Unmatched,
    key_of_folders,
    last_name,
    split_name,
    walk,
)
from filter_core.formats.streams.images import DIGITS, Image, image_at, stem_of
from filter_core.formats.tables.patterns import (
    FRAME,
    LABELS,
    FilePatterns,
    FilesByValues,
    Values,
    prefix_of,
)
from filter_core.formats.words import Role

_ROLES_BY_WORD: Final[Mapping[str, Role]] = {
    "image": "image",
    "segmentation": "segmentation",
    "instances": "instances",
    "depth": "depth",
    "lidar": "lidar",
    "radar": "radar",
    "ignore_mask": "ignore_mask",
}
"""Roles by their words in ``files`` of a description."""

SAME_FRAME: Final = "same frame as {}, which is used"


class DescribedFiles:
    """The files whose roles the patterns of a description say.

    An auxiliary file belongs to the picture that has the same values, or, where no
    pattern says which images are pictures, to that whose key they are: ``front/7`` of
    ``{camera}/{frame}``.

    Parameters
    ----------
    root : Path
        The folder of the recording.
    folder : Path
        That of the pictures, to which names of the files are relative.

    Attributes
    ----------
    of_role : dict of Role to list of Image
        Names of pictures are relative to `folder`, others to `root`.
    """

    def __init__(self, root: Path, folder: Path, files: FilePatterns) -> None:
        self._root, self._folder, self._files = root, folder, files
        self._paths: set[str] = set()
        self.of_role: dict[Role, list[Image]] = {}
        for path in walk(root, None) if files.roles.keys() - {LABELS} else ():
            word, values = files.role_of(path) or ("", {})
            if role := _ROLES_BY_WORD.get(word):
                self._paths.add(path)
                image = self._image(path, role, values)._replace(
                    stream=(files.roles[word].text, "", split_name(path)[1].lower())
                )
                self.of_role.setdefault(role, []).append(image)

    def _image(self, path: str, role: Role, values: Values) -> Image:
        if role == "image":
            name = os.path.relpath(self._root / path, self._folder).replace(os.sep, "/")
            picture = image_at(name, self._folder)
            return picture._replace(role=role, in_pictures=True, values=values)
        others = (value for key, value in values.items() if key != FRAME)
        return image_at(path, self._root)._replace(
            role=role,
            picture="/".join((*others, values[FRAME])),
            frame="/".join(values.values()),
            place=f"{key_of_folders(path.rpartition('/')[0])}{values[FRAME]}",
            values=values,
        )

    def indices(self, role: Role, frames: Sequence[Image]) -> list[DescribedIndex]:
        """The files of a role, if any, each for the frame that it belongs to."""
        images = self.of_role.get(role)
        return [DescribedIndex(images, frames)] if images else []

    def others(self, names: Iterable[str], folder: Path) -> Iterator[str]:
        """The images of a folder that are neither described nor ignored."""
        prefix = prefix_of(self._root, folder)
        if prefix is None or not (self._paths or self._files.ignored):
            yield from names
            return
        for name in names:
            path = f"{prefix}{name}"
            if path not in self._paths and not self._files.ignores(path):
                yield name


class ImageIndex:
    """The images of one role, each for the frame that it belongs to.

    `frames` are the pictures or labels of all frames.
    """

    def __init__(self, images: Sequence[Image], frames: Sequence[Image]) -> None:
        self._images = images
        self._is_used = bytearray(len(images))
        self._same: dict[str, Unmatched] = {}
        self._by_picture = PlacesByKey(image.picture for image in images)
        self._by_frame = PlacesByKey(image.frame for image in images)
        self._by_base = PlacesByKey(last_name(image.frame) for image in images)
        self._frames = PlacesByKey(frame.frame for frame in frames)
        self._bases = PlacesByKey(last_name(frame.frame) for frame in frames)
        self._by_folder = PlacesByKey(image.name.rpartition("/")[0] for image in images)
        self._folders = PlacesByKey(frame.name.rpartition("/")[0] for frame in frames)
        nameless = [
            (place, image)
            for place, image in enumerate(images)
            if image.role is None or image.values is not None
        ]
        self._by_place: dict[str, list[int]] = {}
        for place, image in nameless:
            for path in _places(image):
                self._by_place.setdefault(path, []).append(place)
        near = frames if nameless else ()
        self._places = Counter(path for frame in near for path in _places(frame))

    def take(self, frame: Image) -> Image | None:
        """The image that belongs to a frame."""
        places = self._of(self._by_picture, frame.picture, "picture")
        if not places and len(self._frames.of(frame.frame)) == 1:
            places = self._of(self._by_frame, frame.frame, "frame")
            # What a frame is called; a pattern may have its values in another order.
            by_values = self._of(self._by_picture, frame.frame, "picture")
            places += (place for place in by_values if self._images[place].values)
        if not places:
            places = (
                self._of_this_base(frame)
                or self._in_folder_beside(frame)
                or self._alone_beside(frame)
            )
        if not places:
            return None
        # Of several images, those in a folder of their own come first.
        first, *others = sorted(
            dict.fromkeys(places), key=lambda place: not self._images[place].in_folder
        )
        self._is_used[first] = True
        for place in others:
            if not self._is_used[place]:
                self._is_used[place] = True
                name = self._images[place].name
                why = SAME_FRAME.format(self._images[first].name)
                self._same[name] = Unmatched(name, why)
        return self._images[first]

    def _of(self, index: PlacesByKey, key: str, of: str) -> list[int]:
        """The places of the images with this ``picture`` or ``frame``."""
        return [
            place for place in index.of(key) if getattr(self._images[place], of) == key
        ]

    def _of_this_base(self, frame: Image) -> list[int]:
        """Images are often in a flat folder although pictures are not, or the reverse.

        But only a name that occurs once on both sides identifies a frame. Where words
        of folders differ, they may be those of different cameras; one that was
        recognised by its pixels alone may be called anything.
        """
        base = last_name(frame.frame)
        places = self._by_base.of(base)
        if len(self._bases.of(base)) != 1 or len(places) != 1:
            return []
        image = self._images[places[0]]
        paths = (frame.frame.split("/"), image.frame.split("/"))
        if paths[1][-1] != base:
            return []
        short, long = sorted(paths, key=len)
        extra = len(long) - len(short)  # folders that only one of them is in
        fits = any(
            long[:place] + long[place + extra :] == short for place in range(len(short))
        )
        is_nameless = image.role is None or image.values is not None
        return [places[0]] if fits or is_nameless else []

    def _in_folder_beside(self, frame: Image) -> list[int]:
        """One recognised by its pixels, if one folder's name is all that differs.

        ``town/gt/7.png`` belongs to ``town/pic/7.png`` unless another picture or
        another such image is as near.
        """
        if not self._by_place:
            return []
        near = [
            place
            for path in _places(frame)
            if self._places[path] == 1
            for place in self._by_place.get(path, ())
        ]
        return near if len(near) == 1 else []

    def _alone_beside(self, frame: Image) -> list[int]:
        """The only image of this role in a folder with one picture.

        ``run/scene_rgb.png`` and ``run/semantic.png``, whose own name says its role,
        belong together, unless numbers in their names differ.
        """
        folder = frame.name.rpartition("/")[0]
        places = self._by_folder.of(folder)
        if len(places) != 1 or len(self._folders.of(folder)) != 1:
            return []
        image = self._images[places[0]]
        same_place = image.name.rpartition("/")[0] == folder
        numbers = [DIGITS.findall(stem_of(picture)) for picture in (frame, image)]
        fits = numbers[0] == numbers[1] or not all(numbers)
        return [places[0]] if same_place and fits and image.in_words else []

    def left_over(self, why: str) -> list[Unmatched]:
        """Images that belong to no frame, and those of a frame that has another."""
        unused = (
            Unmatched(image.name, self._why_not(image, why))
            for image, is_used in zip(self._images, self._is_used, strict=True)
            if not is_used
        )
        return [*self._same.values(), *unused]

    def _why_not(self, image: Image, why: str) -> str:
        """Why an image belongs to no frame: mostly `why`, or several are called so."""
        count = len(self._bases.of(last_name(image.frame)))
        if count < 2:
            return why
        return (
            f"{count} frames are called like it, perhaps of several cameras; `files` "
            "in recording.yaml says whose it is"
        )


class DescribedIndex:
    """The files of one role that a description names, each for its frame.

    `frames` are the pictures or labels of all frames.
    """

    def __init__(self, files: Sequence[Image], frames: Sequence[Image]) -> None:
        self._files = {file.name: file for file in files}
        self._by_values = FilesByValues(tuple(files[0].values or ()))
        for file in files:
            self._by_values.add(file.name, file.values or {})
        self._by_key = ImageIndex(files, frames)
        self._taken: set[str] = set()

    def take(self, frame: Image) -> Image | None:
        """The file that belongs to a frame."""
        if frame.values is not None:
            name = self._by_values.take(frame.values)
            file = None if name is None else self._files[name]
        else:
            file = self._by_key.take(frame)
        if file is not None:
            self._taken.add(file.name)
        return file

    def left_over(self, why: str) -> list[Unmatched]:
        """Files that belong to no frame, and those of a frame that has another."""
        unused = {file.path: file for file in self._by_key.left_over(why)}
        return [
            Unmatched(name, self._by_values.unused.get(name) or unused[name].why)
            for name in self._files.keys() - self._taken
            if name in unused
        ]


def _places(image: Image) -> Iterator[str]:
    """The path of an image without one of the names of its folders each."""
    *folders, base = (image.place or image.frame).split("/")
    for level in range(len(folders)):
        yield "/".join((*folders[:level], "*", *folders[level + 1 :], base))
