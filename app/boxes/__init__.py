"""Frames and their boxes: reading, filtering, counting and drawing them."""
