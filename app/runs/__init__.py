"""Runs: one configuration applied to a whole dataset, and what it changes."""
