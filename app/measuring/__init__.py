"""Datasets, configurations and evidence: what is measured, and how it is decided."""
