"""Experiments: detectors trained on the labels of each arm, scored on one truth."""
