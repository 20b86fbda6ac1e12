"""Patterns of paths, by which a description says where a recording's files are.

``CAM_{camera}/{frame}.jpg`` matches paths below the folder; the names in braces stand
for parts of them. Files belong together if the names that their patterns share have the
same values. ``*`` is any part of a name, ``**/`` any folders; their values do not
matter.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

from filter_core.config.declaration import refuse_unknown_keys
from filter_core.errors import ConfigError, LayoutError
from filter_core.formats.reading import (
    IMAGE_SUFFIXES,
    MAX_KEY,
    RECORDING_NAME,
    TEXT_SUFFIXES,
    FrameFileNames,
    Unmatched,
    walk,
)
from filter_core.values import place_of, shown

FRAME: Final = "frame"
"""The name in braces that each pattern has, except that of labels of many frames."""

CAMERA: Final = "camera"

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

    Parameters
    ----------
    text : str

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
        found = self._matches(unicodedata.normalize("NFC", path))
        return None if found is None else found.groupdict()

    def filled(self, values: Values) -> str:
        """The pattern with the values of its names."""
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
    """``files`` of a description.

    Attributes
    ----------
    roles : mapping of str to FilePattern
        By `ROLES`.
    ignored : tuple of FilePattern
        Files that belong to no frame.
    """

    roles: Mapping[str, FilePattern] = field(default_factory=dict)
    ignored: tuple[FilePattern, ...] = ()

    @property
    def document(self) -> dict[str, object]:
        """What a description says."""
        roles: dict[str, object] = {role: one.text for role, one in self.roles.items()}
        ignored = [one.text for one in self.ignored]
        return {**roles, IGNORE: ignored} if ignored else roles

    @cached_property
    def lead(self) -> str:
        """The role whose files say which frames there are."""
        return next((role for role in _PICTURES if role in self.roles), LABELS)

    def below(self, folder: str) -> FilePatterns:
        """The same in a folder, which may be a name in braces itself."""
        roles = {role: one.below(folder) for role, one in self.roles.items()}
        return FilePatterns(roles, tuple(one.below(folder) for one in self.ignored))


class AllowedFiles:
    """Patterns of paths by the role of the files."""

    def __str__(self) -> str:
        return f"patterns of paths by role ({', '.join((*ROLES, IGNORE))})"

    def checked(self, name: str, value: object, at: str = "") -> FilePatterns:
        """See `Allowed.checked`."""
        if isinstance(value, FilePatterns):
            return value
        if not isinstance(value, Mapping):
            raise _refused(name, value, str(self), at)
        place = f"{at}/{name}"
        refuse_unknown_keys(value, (*ROLES, IGNORE), at=place)
        roles = {
            role: _pattern(role, text, place)
            for role, text in value.items()
            if text is not None and role != IGNORE
        }
        ignored = value.get(IGNORE) or []
        if not isinstance(ignored, list) or len(ignored) > _MAX_IGNORED:
            raise _refused(IGNORE, ignored, "a list of patterns of paths", place)
        files = FilePatterns(
            roles, tuple(_pattern(IGNORE, text, place) for text in ignored)
        )
        _check_names(files, place)
        return files

    def schema(self) -> dict[str, object]:
        """See `Allowed.schema`."""
        text: dict[str, object] = {"type": "string", "minLength": 1}
        patterns: dict[str, object] = dict.fromkeys(ROLES, text)
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
        """See `Allowed.checked`."""
        if isinstance(value, FilePattern):
            return value
        pattern = _pattern(name, value, at)
        if FRAME not in pattern.names or "*" in pattern.text:
            raise _refused(name, value, str(self), at)
        return pattern

    def schema(self) -> dict[str, object]:
        """See `Allowed.schema`."""
        return {"type": "string", "minLength": 1, "maxLength": _MAX_LENGTH}


def _pattern(name: str, text: object, at: str) -> FilePattern:
    if not isinstance(text, str):
        raise _refused(name, text, "a pattern of paths", at)
    try:
        return FilePattern(text)
    except ValueError as exc:
        raise _refused(name, text, str(exc), at) from exc


def _check_names(files: FilePatterns, at: str) -> None:
    """Each name must be one of the files that say which frames there are."""
    if not files.roles:
        return
    lead = files.roles.get(files.lead)
    for role, pattern in files.roles.items():
        if FRAME not in pattern.names and role != LABELS:
            raise _refused(role, pattern.text, "a pattern with {frame} in it", at)
        strange = [one for one in pattern.names if lead and one not in lead.names]
        if strange:
            expected = f"only names that {files.lead} has, too"
            raise _refused(role, f"{{{strange[0]}}}", expected, at)


def _refused(name: str, value: object, expected: str, at: str) -> ConfigError:
    return ConfigError(
        f"{place_of(at)}{name}: expected {expected}, found {shown(value)}",
        pointer=f"{at}/{name}",
    )


class PatternFrame(NamedTuple):
    """A frame whose files were matched by patterns.

    Attributes
    ----------
    files : FrameFileNames
        Its label is empty if it has none.
    values : mapping of str to str
        By the names in braces.
    """

    files: FrameFileNames
    values: Values


def plain(value: str) -> str:
    """A value without zeros before a number: ``00000012`` and ``12`` are one frame."""
    return (value.lstrip("0") or "0") if value.isdecimal() else value


class _Files:
    """The files of one role by what the names in their pattern stand for."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._exact: dict[tuple[str, ...], str] = {}
        self._plain: dict[tuple[str, ...], list[str]] = {}
        self.unused: dict[str, str] = {}

    def add(self, path: str, values: Values) -> None:
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
    root : Path
    files : FilePatterns
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
            role: _Files(pattern.names)
            for role, pattern in files.roles.items()
            if role != files.lead
        }
        by_length = sorted(files.roles.items(), key=lambda one: -one[1].fixed)
        for path in walk(root, None) if paths is None else paths:
            is_ignored = any(one.match(path) is not None for one in files.ignored)
            if not is_ignored and path != RECORDING_NAME:
                self._add(path, by_length)

    def _add(self, path: str, patterns: Sequence[tuple[str, FilePattern]]) -> None:
        for role, pattern in patterns:
            values = pattern.match(path)
            if values is None:
                continue
            if role == LABELS:
                self.labels[path] = values
            if role == self._files.lead:
                self._lead.append((path, values))
            else:
                self._others[role].add(path, values)
            return
        if path.lower().endswith((*IMAGE_SUFFIXES, *TEXT_SUFFIXES)):
            self._strange.append(Unmatched(path, "no pattern of `files` fits it"))

    def frames(self, key: FilePattern | None) -> list[PatternFrame]:
        """The frames in the order of their keys.

        `key` says how they are called; by default all names with ``/`` between them.

        Raises
        ------
        LayoutError
            The key has a name in braces that the frames do not have.
        """
        lead = self._files.roles[self._files.lead]
        if key is None:
            key = FilePattern("/".join(f"{{{name}}}" for name in lead.names))
        if strange := [name for name in key.names if name not in lead.names]:
            raise LayoutError(
                f"key: expected only names that files.{self._files.lead} has "
                f"({', '.join(lead.names)}), found {strange[0]!r}"
            )
        found: dict[str, PatternFrame] = {}
        for path, values in self._lead:
            name = key.filled(values)
            if len(name) > MAX_KEY or name in found:
                why = f"another frame is called {name[:MAX_KEY]}, too"
                self._strange.append(Unmatched(path, why))
            else:
                found[name] = PatternFrame(self._frame(name, path, values), values)
        return [found[name] for name in sorted(found)]

    def _frame(self, key: str, path: str, values: Values) -> FrameFileNames:
        own = {self._files.lead: path}
        own |= {
            role: file
            for role, files in self._others.items()
            if (file := files.take(values)) is not None
        }
        label, image = own.pop(LABELS, ""), own.pop("image", None)
        others = {role: self._root / file for role, file in own.items()}
        return FrameFileNames(key, label, image, files=others)

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
