"""Datasets: made, changed, described, removed."""
