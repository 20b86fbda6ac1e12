"""Read a segmentation image, or refuse it, and say what was recognised."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from filter_core.errors import SegmentationError


@dataclass(frozen=True)
class SegmentationOptions:
    """How a segmentation is to be read; ``auto`` leaves it to recognition.

    Attributes
    ----------
    palette : ``auto`` or a key of `filter_core.palettes.FAMILIES`
    encoding : ``auto``, ``palette`` or ``raw``
    channel_order : ``auto``, ``rgb`` or ``bgr``
    lossy : ``refuse`` or ``nearest``
    carla_version : str or None
        The frame's own, the last of those who can name the family.
    sources : Mapping
        Who named each field, for the text of a contradiction; see `agreed`.
    """

    palette: str = "auto"
    encoding: Literal["auto", "palette", "raw"] = "auto"
    channel_order: Literal["auto", "rgb", "bgr"] = "auto"
    lossy: Literal["refuse", "nearest"] = "refuse"
    carla_version: str | None = None
    sources: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def agreed(cls, layers: Mapping[str, SegmentationOptions]) -> SegmentationOptions:
        """What several sources say together, the strongest first.

        Parameters
        ----------
        layers : Mapping
            Such as ``{"the dataset": ..., "the config": ...}``.

        Raises
        ------
        SegmentationError
            ``segmentation_contradiction``, naming both, if two of them differ.
        """
        unset = cls()
        chosen: dict[str, str] = {}
        sources: dict[str, str] = {}
        for source, layer in layers.items():
            for name in ("palette", "encoding", "channel_order", "lossy"):
                value = getattr(layer, name)
                if value == getattr(unset, name):
                    continue
                if chosen.setdefault(name, value) != value:
                    raise SegmentationError(
                        f"{sources[name]} says {name} {chosen[name]}, "
                        f"{source} says {value}",
                        code="segmentation_contradiction",
                    )
                sources.setdefault(name, source)
        version = next(
            (layer.carla_version for layer in layers.values() if layer.carla_version),
            None,
        )
        return cls(**chosen, carla_version=version, sources=sources)  # type: ignore[arg-type]  # values come from fields of the same names
