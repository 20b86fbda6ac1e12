"""Colours and tags of a segmentation image."""
