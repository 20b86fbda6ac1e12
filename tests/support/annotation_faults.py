"""Parses annotations that are refused, and returns their faults."""

from typing import Any

import pytest

from filter_core.annotation.parsing import parse_annotation
from filter_core.errors import AnnotationErrors


def faults_of(raw: Any, **options: Any) -> list[tuple[str, str, str]]:
    """The pointer, code and message of each fault of an annotation."""
    with pytest.raises(AnnotationErrors) as raised:
        parse_annotation(raw, **options)
    return [(fault.pointer, fault.kind, fault.detail) for fault in raised.value.errors]
