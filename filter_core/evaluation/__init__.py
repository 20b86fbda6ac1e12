"""Accuracy of verdicts, agreement between people, and suggested thresholds."""
