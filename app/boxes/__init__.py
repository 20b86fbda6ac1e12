"""Frames and their boxes: stored, selected, counted, answered, drawn."""
