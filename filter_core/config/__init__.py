"""Configurations: their keys, the files that hold them, and what measuring needs."""
