"""Datasets, configurations and evidence: measuring frames, and reading the numbers."""
