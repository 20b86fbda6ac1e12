"""Frames on their way in: checked, measured, stored, one or many."""
