"""`MeasureConfig`: the settings on which measured numbers depend, without thresholds.

`FilterConfig.measuring` makes a `MeasureConfig`. It is identified by its digest: with
equal digests, the same frame gives equal numbers. Digests and `as_dict` are stored
with the numbers, so their form must not change: otherwise every dataset would have to
be measured again.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from filter_core.arrays import IntArray
from filter_core.class_names import canonical_class, class_meant_by
from filter_core.classes import PASS, accept_mask_of
from filter_core.evidence_kinds import CHANNELS, ChannelName, files_for
from filter_core.evidence_numbers import DepthEncoding
from filter_core.frame_boxes import ProjectionMode
from filter_core.segmentation.reading import SegmentationOptions
from filter_core.values import JsonObject
from filter_core.verdicts import Profile

NEWEST_VERSION: Final = 2
"""How frames are measured now, in profile ``paper``:

1. Edges are taken as given, and only the filter's own names of classes have tags.
2. An edge that was rounded becomes a whole number again (`correct_xyxy`), names of
   classes mean what the vocabulary says (`class_meant_by`), and pixels of unknown tags
   are counted (`Evidence.unknown_pixels`).
"""

_READING: Final = ("palette", "encoding", "channel_order", "lossy")


@dataclass(frozen=True, kw_only=True)
class MeasureConfig:
    """How a frame is measured.

    Attributes
    ----------
    profile : ``paper`` or ``carlasimu``
    projection : ``clipped`` or ``naive``
    min_forward : float, metres, or None
        See the key of that name.
    own_reading : SegmentationOptions
        The configuration's own options for segmentations.
    reading : SegmentationOptions
        The same, completed by the dataset's options.
    accept : Mapping
        Tags that count for a class, by its name; classes without one have the default.
    class_map : Mapping
        The class as which a name is measured, or `PASS`; other names mean what the
        vocabulary says.
    renamed : Mapping of str to str
        The dataset's renamed classes: what a class is called now, by the name that
        boxes come with. A name that is missing is unchanged.
    ignored : JsonObject or None
        The dataset's ignored pixels, which never count.
    channels : tuple of ChannelName
        The channels to be measured: names of `CHANNELS`, in that order.
    depth_tolerance : float, metres
        See the key of that name.
    depth_encoding : DepthEncoding
        How depth images are read, if any channel reads them.
    version : int
        How boxes are measured in profile ``paper``, see `NEWEST_VERSION`. A dataset
        keeps the version of its stored numbers until a run measures it again.
    """

    profile: Profile = "paper"
    projection: ProjectionMode = "clipped"
    min_forward: float | None = None
    own_reading: SegmentationOptions = field(default_factory=SegmentationOptions)
    reading: SegmentationOptions = field(default_factory=SegmentationOptions)
    accept: Mapping[str, tuple[str | int, ...]] = field(default_factory=dict)
    class_map: Mapping[str, str] = field(default_factory=dict)
    renamed: Mapping[str, str] = field(default_factory=dict)
    ignored: JsonObject | None = None
    channels: tuple[ChannelName, ...] = ()
    depth_tolerance: float = 0.15
    depth_encoding: DepthEncoding = "auto"
    version: int = NEWEST_VERSION

    @property
    def digest(self) -> str:
        """SHA-256 of `as_dict`; with equal digests, a frame gives equal numbers."""
        return _digest(self.as_dict())

    @property
    def pixel_digest(self) -> str:
        """A digest that changes only with what needs the pixels again.

        Accept sets and renamed classes do not change it, if they need no pixels.
        Numbers for other accept sets follow from the stored histograms of tags, so that
        configurations with equal pixel digests need no images read again. With
        channels, or under profile ``carlasimu``, accept sets do count.
        """
        plain = self.as_dict()
        # Channels store no histograms, so other accept sets need the pixels again.
        # Under carlasimu, `as_dict` has them in "measure" too.
        if self.channels:
            return _digest(plain)
        if self.profile == "paper":
            for name in ("class_map", "renamed"):
                plain.pop(name, None)
        return _digest(plain | {"accept": None})

    def as_dict(self) -> dict[str, object]:
        """The stored form, ready for JSON.

        ``channels``, ``class_map``, ``min_forward``, ``renamed``, ``tags`` and
        ``tag_scale`` only where there are any, ``version`` only where it makes a
        difference and is not the first.
        """
        own = [getattr(self.own_reading, name) for name in _READING]
        by_name: list[object] = [self.profile, *own, self.projection]
        accept = {name: list(tags) for name, tags in self.accept.items()}
        if self.profile == "carlasimu":
            # It counts one colour per class; other accept sets need the pixels again.
            by_name.append([[name, tags] for name, tags in accept.items()])
        plain: dict[str, object] = {
            "measure": by_name,
            "accept": accept,
            "reading": {name: getattr(self.reading, name) for name in _READING},
            "ignored": self.ignored,
        }
        optional: dict[str, object] = {
            "tags": dict(self.reading.tags),
            "tag_scale": self.reading.tag_scale,
            "class_map": dict(self.class_map),
            "version": self.version if self.profile == "paper" else 1,
            "renamed": dict(self.renamed),
        }
        plain |= {
            name: value for name, value in optional.items() if value not in ({}, 1)
        }
        if self.min_forward is not None:
            plain["min_forward"] = self.min_forward
        if not self.channels:
            return plain
        tolerance = self.depth_tolerance if "depth" in self.channels else None
        stored: dict[str, object] = {
            "names": list(self.channels),
            "depth_tolerance": tolerance,
        }
        if self.depth_encoding != "auto" and "depth" in self.files:
            stored["depth_encoding"] = self.depth_encoding
        return plain | {"channels": stored}

    def with_channels(self, names: Collection[str]) -> MeasureConfig:
        """The same, with these channels measured as well."""
        all_names = {*self.channels, *names}
        return replace(
            self, channels=tuple(name for name in CHANNELS if name in all_names)
        )

    def as_measured(self, stored: JsonObject) -> MeasureConfig:
        """The same, as a stored measurement was made.

        That is, with its reading, renamed classes, ignored pixels, channels, version.
        `stored` is `as_dict` of the measurement's `MeasureConfig`, and has under
        ``sources`` the `SegmentationOptions.sources` of its `reading`.
        """
        channels, tolerance, encoding = _channels_of(stored)
        return replace(
            self,
            reading=SegmentationOptions(
                **stored["reading"],
                sources=stored["sources"],
                tags=stored.get("tags", {}),
                tag_scale=stored.get("tag_scale", 1),
            ),
            renamed=stored.get("renamed", {}),
            ignored=stored["ignored"],
            channels=channels,
            depth_tolerance=self.depth_tolerance if tolerance is None else tolerance,
            depth_encoding=(
                encoding if "depth" in files_for(channels) else self.depth_encoding
            ),
            version=stored.get("version", 1),
        )

    def is_covered_by(self, stored: JsonObject) -> bool:
        """Whether a stored measurement has all the numbers that this would measure.

        `stored` is `as_dict` of the measurement's `MeasureConfig`. It may have more
        channels.
        """
        channels, tolerance, encoding = _channels_of(stored)
        plain = self.as_dict()
        optional = {
            *("class_map", "renamed", "version", "tags", "tag_scale", "min_forward")
        }
        compared = {*plain, *optional} - {"channels"}
        return (
            set(self.channels) <= set(channels)
            and ("depth" not in self.channels or self.depth_tolerance == tolerance)
            and ("depth" not in self.files or self.depth_encoding == encoding)
            and all(stored.get(key) == plain.get(key) for key in compared)
        )

    @property
    def files(self) -> tuple[str, ...]:
        """The kinds of files that its channels read, besides the segmentation."""
        return files_for(self.channels)

    def requires(self, kind: str) -> bool:
        """Whether a frame is refused if its file of this kind is no evidence.

        Only if nothing else is measured. With other channels besides it, boxes can be
        judged by those instead. It follows from `channels`, which the digest covers.
        """
        return self.files == (kind,) and "ordered" not in self.channels

    def measured_class(self, name: str) -> str:
        """The class as which boxes of this name are measured, or `PASS`."""
        own_name = canonical_class(name)
        if own_name in self.class_map:
            return self.class_map[own_name]
        # Profile carlasimu knows the names of the published code only.
        if self.profile == "carlasimu" or self.version == 1:
            return own_name
        return class_meant_by(name) or name

    def accept_masks(self, class_names: Iterable[str], family: str | None) -> IntArray:
        """(K,) int64: the tags each class accepts, bit t for tag t; 0 if not mapped.

        `family` is the tag family of the segmentation, None if there is none. Raises
        `ConfigError`: a class accepts a tag that the family does not have.
        """
        masks = [self._accept_mask(name, family) for name in class_names]
        return np.array(masks, dtype=np.int64)

    def _accept_mask(self, name: str, family: str | None) -> int:
        measured_as = self.measured_class(name)
        if measured_as == PASS:
            return 0
        accept = self.accept.get(canonical_class(name), self.accept.get(measured_as))
        return accept_mask_of(measured_as, family, self.profile, accept)


def _channels_of(
    stored: JsonObject,
) -> tuple[tuple[ChannelName, ...], float | None, DepthEncoding]:
    """Channels, `depth_tolerance` and `depth_encoding` of a stored measurement."""
    channels = stored.get("channels") or {}
    return (
        tuple(channels.get("names", ())),
        channels.get("depth_tolerance"),
        channels.get("depth_encoding", "auto"),
    )


def _digest(plain: Mapping[str, object]) -> str:
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
