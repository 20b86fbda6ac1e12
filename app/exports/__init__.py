"""Exports: background jobs that write the labels of a dataset to a file."""
