"""Patterns of paths, by which a description says where a recording's files are.

``CAM_{camera}/{frame}.jpg`` matches paths below the folder; the names in braces stand
for parts of them. Files belong together if the names that their patterns share have the
same values. ``*`` is any part of a name, ``**/`` any folders; their values do not
matter.
"""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from filter_core.config.declaration import refuse_unknown_keys, wrong_value
from filter_core.errors import LayoutError
from filter_core.formats.matching import FrameFileNames
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    MAX_KEY,
    RECORDING_NAME,
    TEXT_SUFFIXES,
    Unmatched,
    walk,
)

FRAME: Final = "frame"
"""The name in braces that each pattern has, except that of labels of many frames."""

CAMERA: Final = "camera"

MAP: Final = "map"
"""The name in braces that stands for the map of CARLA."""

LABELS: Final = "labels"

IGNORE: Final = "ignore"

_PICTURES: Final = ("image", "segmentation", "instances", "depth")
"""Roles of images; the first that has a pattern says which frames there are."""

ROLES: Final = (*_PICTURES, "lidar", "radar", "ignore_mask", LABELS)

_TOKEN: Final = re.compile(r"\{(?P<name>[^{}]*)\}|(?P<any>\*\*/)|(?P<part>\*)")

_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")

_MAX_LENGTH: Final = 500

_MAX_NAMES: Final = 6
"""More would take long to match against a name that nearly fits."""

_MAX_IGNORED: Final = 100

Values: TypeAlias = Mapping[str, str]
"""What the names in braces stand for in one path."""


class FilePattern:
    """The paths of the files of one role, relative to the folder.

    Attributes
    ----------
    names : tuple of str
        Those in braces, in the order in which they first occur.
    fixed : int
        Characters that are not in braces: the more, the more specific it is.

    Raises
    ------
    ValueError
        It is no such pattern, or leads out of the folder; says what was expected.
    """

    def __init__(self, text: str) -> None:
        self.text = unicodedata.normalize("NFC", text.replace("\\", "/"))
        parts = self.text.split("/")
        if not text or len(text) > _MAX_LENGTH or {"", ".."} & {*parts} or ":" in text:
            raise ValueError("a path below the folder")
        names: list[str] = []
        expression, end, after_name = "", 0, False
        for token in _TOKEN.finditer(self.text):
            between = self.text[end : token.start()]
            if "{" in between or "}" in between:
                raise ValueError("names in braces, such as {frame}")
            is_name = token["name"] is not None
            if is_name and after_name and not between:
                raise ValueError("something between two names in braces")
            expression += re.escape(between) + _expression(token, names)
            end, after_name = token.end(), is_name
        rest = self.text[end:]
        if "{" in rest or "}" in rest or len(names) > _MAX_NAMES:
            raise ValueError(f"at most {_MAX_NAMES} names in braces, such as {{frame}}")
        self.names = tuple(names)
        self.fixed = len(_TOKEN.sub("", self.text))
        self._matches = re.compile(expression + re.escape(rest)).fullmatch

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FilePattern) and other.text == self.text

    def __hash__(self) -> int:
        return hash(self.text)

    def __repr__(self) -> str:
        return f"FilePattern({self.text!r})"

    def match(self, path: str) -> dict[str, str] | None:
        """What its names stand for in a path; None if the path does not fit."""
        match = self._matches(unicodedata.normalize("NFC", path))
        return None if match is None else match.groupdict()

    def filled(self, values: Values) -> str:
        """The path, or the key, with these values in the place of the names."""
        return _TOKEN.sub(
            lambda token: values[token["name"]] if token["name"] else token[0],
            self.text,
        )

    def below(self, folder: str) -> FilePattern:
        """The same in a folder, which may be a name in braces itself."""
        return FilePattern(f"{folder}/{self.text}")


def _expression(token: re.Match[str], names: list[str]) -> str:
    """The regular expression of what is not fixed; adds its name to `names`."""
    name = token["name"]
    if name is None:
        return r"(?:[^/]+/)*" if token["any"] else r"[^/]*"
    if not _NAME.fullmatch(name):
        raise ValueError("names of letters and digits in braces, such as {frame}")
    if name in names:
        return f"(?P={name})"
    names.append(name)
    return rf"(?P<{name}>[^/]+)"


@dataclass(frozen=True)
class FilePatterns:
    """``files`` of a description: a pattern for each of `ROLES`.

    There may be `more` of a role, with the same names in braces as its first. Files
    that are `ignored` belong to no frame.
    """

    roles: Mapping[str, FilePattern] = field(default_factory=dict)
    ignored: tuple[FilePattern, ...] = ()
    more: Mapping[str, tuple[FilePattern, ...]] = field(default_factory=dict)

    @property
    def document(self) -> dict[str, object]:
        """What a description says."""
        roles: dict[str, object] = {
            role: pattern.text for role, pattern in self.roles.items()
        }
        for role, others in self.more.items():
            roles[role] = [roles[role], *(pattern.text for pattern in others)]
        ignored = [pattern.text for pattern in self.ignored]
        return {**roles, IGNORE: ignored} if ignored else roles

    @cached_property
    def _by_length(self) -> list[tuple[str, FilePattern]]:
        more = (
            (role, pattern) for role, others in self.more.items() for pattern in others
        )
        every = (*self.roles.items(), *more)
        return sorted(every, key=lambda each: -each[1].fixed)

    def role_of(self, path: str) -> tuple[str, dict[str, str]] | None:
        """The role of a file, and what the names in its pattern stand for.

        Of several patterns that fit, the most specific one says it. None: no pattern
        fits, or the file is ignored.
        """
        if self.ignores(path):
            return None
        for role, pattern in self._by_length:
            if (values := pattern.match(path)) is not None:
                return role, values
        return None

    def ignores(self, path: str) -> bool:
        """Whether a file, by its path below the folder, is left out."""
        return any(each.match(path) is not None for each in self.ignored)

    def walk(
        self,
        root: Path,
        folder: Path,
        suffixes: Collection[str] | None,
        skip: Collection[Path] = (),
    ) -> Iterator[str]:
        """The files of a folder that are not ignored, relative to it; as `walk`.

        Patterns are relative to the recording's folder, `root`. In a folder that is not
        below it nothing is ignored.
        """
        names = walk(folder, suffixes, skip)
        prefix = prefix_of(root, folder) if self.ignored else None
        if prefix is None:
            return names
        return (name for name in names if not self.ignores(f"{prefix}{name}"))

    def glob(self, source: Path, *patterns: str) -> list[Path]:
        """The files of a folder that match and are not ignored; of a file, itself."""
        if source.is_file():
            return [source]
        paths = sorted(path for pattern in patterns for path in source.glob(pattern))
        return [
            path
            for path in paths
            if not self.ignores(path.relative_to(source).as_posix())
        ]

    @cached_property
    def lead(self) -> str:
        """The role whose files say which frames there are."""
        return next((role for role in _PICTURES if role in self.roles), LABELS)

    def below(self, folder: str) -> FilePatterns:
        """The same in a folder, which may be a name in braces itself."""
        roles = {role: pattern.below(folder) for role, pattern in self.roles.items()}
        ignored = tuple(pattern.below(folder) for pattern in self.ignored)
        more = {
            role: tuple(pattern.below(folder) for pattern in others)
            for role, others in self.more.items()
        }
        return FilePatterns(roles, ignored, more)


def prefix_of(root: Path, folder: Path) -> str | None:
    """What comes before a name in a folder, relative to `root`; None: elsewhere."""
    path = os.path.relpath(folder, root).replace(os.sep, "/")
    if path == ".":
        return ""
    return None if path.startswith("../") or path == ".." else f"{path}/"


class AllowedFiles:
    """Patterns of paths by the role of the files."""

    def __str__(self) -> str:
        return f"patterns of paths by role ({', '.join((*ROLES, IGNORE))})"

    def checked(self, name: str, value: object, at: str = "") -> FilePatterns:
        if isinstance(value, FilePatterns):
            return value
        if not isinstance(value, Mapping):
            raise wrong_value(name, value, str(self), at)
        place = f"{at}/{name}"
        refuse_unknown_keys(value, (*ROLES, IGNORE), at=place)
        several = {
            role: _patterns(role, texts, place)
            for role, texts in value.items()
            if texts is not None and role != IGNORE
        }
        roles = {role: patterns[0] for role, patterns in several.items()}
        more = {role: rest for role, (_, *rest) in several.items() if rest}
        ignored = value.get(IGNORE) or []
        if not isinstance(ignored, list) or len(ignored) > _MAX_IGNORED:
            raise wrong_value(IGNORE, ignored, "a list of patterns of paths", place)
        files = FilePatterns(
            roles,
            tuple(_pattern(IGNORE, text, place) for text in ignored),
            {role: tuple(rest) for role, rest in more.items()},
        )
        # Each name must be one of the files that say which frames there are
        if files.roles:
            lead = files.roles.get(files.lead)
            for role, pattern in files.roles.items():
                if FRAME not in pattern.names and role != LABELS:
                    raise wrong_value(
                        role, pattern.text, "a pattern with {frame} in it", place
                    )
                strange = [
                    name for name in pattern.names if lead and name not in lead.names
                ]
                if strange:
                    expected = f"only names that {files.lead} has, too"
                    raise wrong_value(role, f"{{{strange[0]}}}", expected, place)
        return files

    def schema(self) -> dict[str, object]:
        text: dict[str, object] = {"type": "string", "minLength": 1}
        several = {"type": "array", "items": text, "minItems": 1}
        patterns = {role: {"anyOf": [text, several]} for role in ROLES}
        return {
            "type": "object",
            "properties": {**patterns, IGNORE: {"type": "array", "items": text}},
            "additionalProperties": False,
        }


class AllowedKeyPattern:
    """How frames are called, such as ``{camera}/{frame}``."""

    def __str__(self) -> str:
        return "a text with {frame} in it, such as {camera}/{frame}"

    def checked(self, name: str, value: object, at: str = "") -> FilePattern:
        if isinstance(value, FilePattern):
            return value
        pattern = _pattern(name, value, at)
        if FRAME not in pattern.names or "*" in pattern.text:
            raise wrong_value(name, value, str(self), at)
        return pattern

    def schema(self) -> dict[str, object]:
        return {"type": "string", "minLength": 1, "maxLength": _MAX_LENGTH}


def _pattern(name: str, text: object, at: str) -> FilePattern:
    if not isinstance(text, str):
        raise wrong_value(name, text, "a pattern of paths", at)
    try:
        return FilePattern(text)
    except ValueError as exc:
        raise wrong_value(name, text, str(exc), at) from exc


def _patterns(role: str, texts: object, at: str) -> list[FilePattern]:
    """The pattern of a role, or several of them with the same names in braces."""
    if not isinstance(texts, list):
        return [_pattern(role, texts, at)]
    patterns = [_pattern(role, text, at) for text in texts]
    alike = {frozenset(pattern.names) for pattern in patterns}
    if len(alike) != 1 or role == LABELS or len(patterns) > _MAX_IGNORED:
        expected = "a pattern, or a list of patterns that have the same names in braces"
        if role == LABELS:
            expected = "one pattern"
        raise wrong_value(role, texts, expected, at)
    return patterns


class PatternFrame(NamedTuple):
    """A frame whose files were matched by patterns.

    The label of `files` is empty if it has none; `values` are by the names in braces.
    """

    files: FrameFileNames
    values: Values


def plain(value: str) -> str:
    """A value without zeros before a number: ``00000012`` and ``12`` are one frame."""
    return (value.lstrip("0") or "0") if value.isdecimal() else value


class FilesByValues:
    """The files of one role by what the names in their pattern stand for.

    Parameters
    ----------
    names : sequence of str
        Those in the pattern.

    Attributes
    ----------
    unused : dict of str to str
        Files that no frame has, each with the reason, or an empty text.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._exact: dict[tuple[str, ...], str] = {}
        self._plain: dict[tuple[str, ...], list[str]] = {}
        self.unused: dict[str, str] = {}

    def add(self, path: str, values: Values) -> None:
        """One more file."""
        exact = tuple(values[name] for name in self._names)
        first = self._exact.setdefault(exact, path)
        self.unused[path] = "" if first == path else f"same frame as {first}"
        self._plain.setdefault(tuple(map(plain, exact)), []).append(path)

    def take(self, values: Values) -> str | None:
        """The file of a frame; numbers may have different zeros before them."""
        exact = tuple(values[name] for name in self._names)
        path = self._exact.get(exact)
        if path is None:
            alike = self._plain.get(tuple(map(plain, exact)), [])
            path = alike[0] if len(alike) == 1 else None
        if path is not None:
            self.unused.pop(path, None)
        return path


def described_frames(
    root: Path, files: FilePatterns, key: FilePattern | None
) -> tuple[list[PatternFrame], tuple[Unmatched, ...]]:
    """The frames of a folder by patterns, and the files that belong to none."""
    matched = PatternFiles(root, files)
    return matched.frames(key), tuple(matched.left_over())


class PatternFiles:
    """The files below a folder that fit the patterns, and those that do not.

    Parameters
    ----------
    paths : iterable of str, optional
        All files below the folder. Default: those that are there.

    Attributes
    ----------
    labels : dict of str to dict
        Every label file with what its names stand for.
    """

    def __init__(
        self, root: Path, files: FilePatterns, paths: Iterable[str] | None = None
    ) -> None:
        self._root, self._files = root, files
        self._strange: list[Unmatched] = []
        self.labels: dict[str, dict[str, str]] = {}
        self._lead: list[tuple[str, dict[str, str]]] = []
        self._others = {
            role: FilesByValues(pattern.names)
            for role, pattern in files.roles.items()
            if role != files.lead
        }
        for path in walk(root, None) if paths is None else paths:
            if not files.ignores(path) and path != RECORDING_NAME:
                self._add(path)

    def _add(self, path: str) -> None:
        matched = self._files.role_of(path)
        if matched is None:
            if path.lower().endswith((*IMAGE_SUFFIXES, *TEXT_SUFFIXES)):
                self._strange.append(Unmatched(path, "no pattern of `files` fits it"))
            return
        role, values = matched
        if role == LABELS:
            self.labels[path] = values
        if role == self._files.lead:
            self._lead.append((path, values))
        else:
            self._others[role].add(path, values)

    def frames(self, key: FilePattern | None) -> list[PatternFrame]:
        """The frames in the order of their keys.

        `key` says how they are called; by default all names with ``/`` between them.
        Raises `LayoutError`: the key has a name in braces that the frames do not have.
        """
        lead = self._files.roles[self._files.lead]
        if key is None:
            key = FilePattern("/".join(f"{{{name}}}" for name in lead.names))
        if strange := [name for name in key.names if name not in lead.names]:
            raise LayoutError(
                f"key: expected only names that files.{self._files.lead} has "
                f"({', '.join(lead.names)}), found {strange[0]!r}"
            )
        frames: dict[str, PatternFrame] = {}
        for path, values in self._lead:
            name = key.filled(values)
            if len(name) > MAX_KEY or name in frames:
                why = f"another frame is called {name[:MAX_KEY]}, too"
                self._strange.append(Unmatched(path, why))
            else:
                own = {self._files.lead: path}
                own |= {
                    role: file
                    for role, files in self._others.items()
                    if (file := files.take(values)) is not None
                }
                label, image = own.pop(LABELS, ""), own.pop("image", None)
                others = {role: self._root / file for role, file in own.items()}
                frames[name] = PatternFrame(
                    FrameFileNames(name, label, image, values.get(MAP), files=others),
                    values,
                )
        return [frames[name] for name in sorted(frames)]

    def left_over(self, *, labels: bool = True) -> Iterator[Unmatched]:
        """The files that belong to no frame; without labels if those are read whole."""
        yield from self._strange
        lead = "label file" if self._files.lead == LABELS else self._files.lead
        for role, files in self._others.items():
            if role == LABELS and not labels:
                continue
            noun = "label file" if role == LABELS else role
            for path, why in files.unused.items():
                yield Unmatched(path, why or f"no {lead} for this {noun}")
