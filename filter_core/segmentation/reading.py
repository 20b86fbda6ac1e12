"""Reading segmentations: a file or an array of tags in, a `Segmentation` out.

`read_segmentation` reads an image file of any form that CARLA or its users write,
according to the given options (`SegmentationOptions`) and the colours that occur, or
refuses it with the reason. `segmentation_from_tags` takes an array of tags of a known
family.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final, Literal, Protocol, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from filter_core.arrays import TagImage
from filter_core.errors import FilterError, ImageError, SegmentationError, file_context
from filter_core.images.decoding import decode_color, decode_image
from filter_core.images.drawing import as_png
from filter_core.images.header import (
    MAX_SIDE,
    ImageHeader,
    read_image_header,
    require_size,
)
from filter_core.images.pixels import ChannelOrder, count_codes, occurring_codes
from filter_core.segmentation.codes import (
    NO_FAMILY,
    Segmentation,
    exact_codes,
    unpacked,
)
from filter_core.segmentation.palettes import (
    FAMILIES,
    LAST_TAG,
    PAPER_TABLE,
    UNCHANGED,
    ChangedTags,
    UnknownVersion,
    family_of_version,
    palette_of,
)
from filter_core.segmentation.recognition import NamedReading, contradiction
from filter_core.segmentation.tags import (
    looks_raw,
    lost_tags,
    raw_segmentation,
    read_exact_colors,
    read_nearest_colors,
    read_raw_channel,
    read_raw_tags,
    refuse_lost_tags,
    refuse_unlike_palettes,
)

FAMILY_NAMES: Final = ("auto", *FAMILIES)
"""The values of the option `palette`: the families, and ``auto`` to recognise it."""

Encoding: TypeAlias = Literal["auto", "palette", "raw"]

OrderOfChannels: TypeAlias = Literal["auto", "rgb", "bgr"]

Lossy: TypeAlias = Literal["refuse", "nearest"]

TagScale: TypeAlias = Literal["auto"] | int

_FIELDS = ("palette", "encoding", "channel_order", "lossy")

_COLOR: Final = "#"

_NEEDS_A_FAMILY: Final = ("family_not_named", "ambiguous_palette")
"""Errors that a known version of CARLA would prevent."""


class NamesReading(Protocol):
    """An object with options for segmentations: a configuration or a dataset."""

    @property
    def palette(self) -> str: ...
    @property
    def encoding(self) -> Encoding: ...
    @property
    def channel_order(self) -> OrderOfChannels: ...
    @property
    def lossy_segmentation(self) -> Lossy: ...


@dataclass(frozen=True)
class SegmentationOptions:
    """How a segmentation is to be read; ``auto`` leaves it to recognition.

    Attributes
    ----------
    palette : ``auto`` or a key of `filter_core.segmentation.palettes.FAMILIES`
    encoding : ``auto``, ``palette`` or ``raw``
    channel_order : ``auto``, ``rgb`` or ``bgr``
    lossy : ``refuse`` or ``nearest``
    carla_version : str or None
        The frame's own, the last of those who can name the family.
    sources : Mapping
        Who named each field, for the text of a contradiction; see `agreed`.
    tags : Mapping of str to str
        Numbers (``40``) and colours (``#dc143c``) of a changed CARLA, each with the
        name of its tag.
    tag_scale : int
        Raw images have multiples of this in the place of tags.
    """

    palette: str = "auto"
    encoding: Encoding = "auto"
    channel_order: OrderOfChannels = "auto"
    lossy: Lossy = "refuse"
    carla_version: str | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    tags: Mapping[str, str] = field(default_factory=dict)
    tag_scale: int = 1

    @property
    def changed(self) -> ChangedTags:
        """What a changed CARLA writes otherwise."""
        if not self.tags and self.tag_scale == 1:
            return UNCHANGED
        named = self.tags.items()
        return ChangedTags(
            numbers=tuple((int(k), v) for k, v in named if not k.startswith(_COLOR)),
            colors=tuple(
                (unpacked(int(k[1:], 16)), v) for k, v in named if k.startswith(_COLOR)
            ),
            scale=self.tag_scale,
        )

    @classmethod
    def named_by(cls, source: NamesReading) -> SegmentationOptions:
        """The options of a configuration or a dataset, whose values were checked."""
        return cls(
            palette=source.palette,
            encoding=source.encoding,
            channel_order=source.channel_order,
            lossy=source.lossy_segmentation,
        )

    @classmethod
    def agreed(cls, layers: Mapping[str, SegmentationOptions]) -> SegmentationOptions:
        """The options of several sources combined, the strongest first.

        `layers` are such as ``{"the dataset": ..., "the configuration": ...}``. Raises
        `SegmentationError`: ``segmentation_contradiction``, naming both, if two of them
        differ.
        """
        unset = cls()
        by = dict.fromkeys(_FIELDS, unset)
        sources: dict[str, str] = {}
        for source, layer in layers.items():
            for name in _FIELDS:
                value = getattr(layer, name)
                if value == getattr(unset, name):
                    continue
                if name not in sources:
                    sources[name], by[name] = source, layer
                elif getattr(by[name], name) != value:
                    raise contradiction(
                        f"{sources[name]} says {name} {getattr(by[name], name)}, "
                        f"{source} says {value}"
                    )
        version = next(
            (layer.carla_version for layer in layers.values() if layer.carla_version),
            None,
        )
        return cls(
            palette=by["palette"].palette,
            encoding=by["encoding"].encoding,
            channel_order=by["channel_order"].channel_order,
            lossy=by["lossy"].lossy,
            carla_version=version,
            sources=sources,
            tags=next((layer.tags for layer in layers.values() if layer.tags), {}),
            tag_scale=max(layer.tag_scale for layer in layers.values()),
        )


def read_segmentation(
    content: bytes,
    options: SegmentationOptions | None = None,
    *,
    expected_wh: tuple[int, int] | None = None,
    max_side: int = MAX_SIDE,
) -> Segmentation:
    """Read a segmentation file of any form.

    Its tags are computed lazily; a rotation in EXIF is not applied.

    Parameters
    ----------
    content : bytes
        PNG: palette-coloured RGB, RGBA or indexed; raw tags in 8-bit grey or in the
        red channel. JPEG: palette-coloured, if `options.lossy` is ``nearest``.
    options : SegmentationOptions
    expected_wh : (width, height), px
        The RGB image's and the camera's size.
    max_side : int, px
        Checked against the header, before anything is decoded.

    Raises
    ------
    ImageError
        Not a PNG or JPEG that can be decoded; `ImageTooLarge`, `ImageSizeMismatch`.
    SegmentationError
        `kind` is ``lossy_segmentation``, ``foreign_colors``, ``foreign_tags``,
        ``family_not_named``, ``ambiguous_palette``, ``segmentation_contradiction``
        or ``bad_segmentation``.
    """
    options = options or SegmentationOptions()
    with file_context("segmentation"):
        header = read_image_header(content, max_side=max_side)
    if expected_wh is not None:
        require_size(header, expected_wh, what="the segmentation", than="the image")
    grey = header.color_model in ("grey", "grey_alpha")
    if header.bit_depth == 16 or (grey and header.bit_depth != 8):
        raise SegmentationError(
            f"expected 8 bits per channel, found {header.bit_depth}; "
            "a tag or a colour is one byte"
        )
    if grey and options.encoding == "palette":
        raise contradiction(
            f"{_source(options, 'encoding')} says encoding palette, "
            "the image is grey, so it can only hold raw tags"
        )
    is_scaled = options.encoding == "auto" and options.changed.scale > 1
    is_raw = grey or options.encoding == "raw" or is_scaled
    if header.media_type == "image/jpeg" and is_raw:
        raise lost_tags("a grey JPEG" if grey else "a JPEG that is to be read as raw")
    named, notes = _named(options)
    with file_context("segmentation"):
        pixels = _decode(content, header)
    try:
        if grey:
            tags = pixels if pixels.ndim == 2 else cv2.extractChannel(pixels, 0)
            read = read_raw_tags(tags.astype(np.uint8, copy=False), named)
        else:
            read = _read_channels(pixels, header, options, named)
    except SegmentationError as error:
        if not notes or error.kind not in _NEEDS_A_FAMILY:
            raise
        # A version was given, but an unknown one.
        text = "; ".join((str(error), *notes))
        raise SegmentationError(text, code=error.kind) from None
    return replace(read, notes=(*read.notes, *notes)) if notes else read


def segmentation_from_tags(
    tags: TagImage, family: str, changed: ChangedTags = UNCHANGED
) -> Segmentation:
    """A segmentation from an array of tags.

    Parameters
    ----------
    tags : (H, W) uint8
        255 is Unknown, and so is a tag that the family does not have. Not copied.
    family : key of `filter_core.segmentation.palettes.FAMILIES`
    changed : ChangedTags
        Of a changed CARLA; the tags are numbers, not multiples of them.

    Raises
    ------
    SegmentationError
        ``bad_segmentation``: another shape or dtype.
    UnknownFamily
        If there is no such family.
    """
    palette_of(family)
    if tags.ndim != 2 or tags.dtype != np.uint8 or not tags.size:
        raise SegmentationError(
            f"tags: expected an array (H, W) of uint8, found {tags.shape} {tags.dtype}"
        )
    counts = count_codes(tags, exact_codes(UNCHANGED))
    return raw_segmentation(tags, counts, family, "rgb", changed)


def _read_channels(
    rgb: NDArray[np.uint8],
    header: ImageHeader,
    options: SegmentationOptions,
    named: NamedReading,
) -> Segmentation:
    is_scaled = options.encoding == "auto" and named.changed.scale > 1
    if options.encoding == "raw" or is_scaled:
        return read_raw_channel(rgb, named)
    if header.media_type == "image/jpeg":
        refuse_lost_tags(rgb, is_jpeg=True)
        if options.lossy != "nearest":
            refuse_unlike_palettes(rgb)
            raise SegmentationError(
                "the segmentation is a JPEG, whose colours are no longer those that "
                "CARLA wrote; expected a PNG. lossy_segmentation: nearest reads it by "
                "the nearest colour and marks every decision as lossy",
                code="lossy_segmentation",
            )
        return read_nearest_colors(rgb, named)
    occurring = occurring_codes(rgb, exact_codes(named.changed))
    no_family = NO_FAMILY in occurring
    last = max((LAST_TAG, *(number for number, _ in named.changed.numbers)))
    if no_family and options.encoding == "auto" and looks_raw(rgb, last):
        return read_raw_channel(rgb, named)
    if no_family:
        refuse_lost_tags(rgb, is_jpeg=False)
    if no_family and options.lossy == "nearest":
        return read_nearest_colors(rgb, named)
    return read_exact_colors(rgb, occurring, named)


def _named(options: SegmentationOptions) -> tuple[NamedReading, tuple[str, ...]]:
    """The named family, from the options or else the frame's version, and notes."""
    order: ChannelOrder | None
    order = None if options.channel_order == "auto" else options.channel_order
    family = None if options.palette == "auto" else palette_of(options.palette).name
    sources = {name: _source(options, name) for name in _FIELDS}
    changed = options.changed
    if options.carla_version is None:
        return NamedReading(family, order, sources, changed), ()
    try:
        rendered = family_of_version(options.carla_version)
    except UnknownVersion as unknown:
        notes = (f"{unknown}; not used",)
        return NamedReading(family, order, sources, changed), notes
    version = f"carla_version {options.carla_version}"
    # The paper's table is no version's: naming it says how to read, not who rendered.
    if family not in (None, rendered, PAPER_TABLE):
        raise contradiction(
            f"{sources['palette']} says palette {family}, {version} renders {rendered}"
        )
    if family is None:
        family, sources["palette"] = rendered, version
    return NamedReading(family, order, sources, changed), ()


def _source(options: SegmentationOptions, name: str) -> str:
    return options.sources.get(name, "the caller")


def _decode(content: bytes, header: ImageHeader) -> NDArray[np.uint8]:
    """(H, W) or (H, W, 2 or 4) if it is grey, else (H, W, 3) red, green, blue."""
    is_grey = header.color_model in ("grey", "grey_alpha")
    pixels = (
        decode_image(content, header, cv2.IMREAD_UNCHANGED)
        if is_grey
        else decode_color(content, header, "rgb")
    )
    if pixels is None:
        raise ImageError(
            f"the {header.media_type} of {header.width} x {header.height} pixels "
            "cannot be decoded: it is damaged"
        )
    return pixels


def in_colors(content: bytes, options: SegmentationOptions) -> bytes:
    """A segmentation in the colours of its family, as CARLA's converter saves it.

    A file that has colours already, or that these options do not read, comes back as it
    is.
    """
    try:
        read = read_segmentation(content, options)
    except FilterError:
        return content
    if read.encoding == "palette":
        return content
    painted = FAMILIES[read.family].paint(read.tags)
    return as_png(np.ascontiguousarray(painted[..., ::-1]))
