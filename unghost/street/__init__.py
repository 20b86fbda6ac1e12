"""A synthetic street with known truth: images, tags, boxes, and which are ghosts."""

from __future__ import annotations
