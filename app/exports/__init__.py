"""Exports: the labels of a dataset, written in the background."""
