"""From the filters of a request to those of the services."""

from __future__ import annotations

from dataclasses import fields

from app.services.box_selection import Selection
from unghost.wire.boxes import BoxSelection

_NAMES = {spec.name for spec in fields(Selection)}


def selection_of(query: BoxSelection) -> Selection:
    """The filters among the parameters of a list."""
    return Selection(**query.model_dump(include=_NAMES))
