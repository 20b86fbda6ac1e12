"""Runs a notebook in a kernel of its own and prints it, outputs included.

A program and no function: what Jupyter warns about is no fault of a test.
"""

from __future__ import annotations

import sys

import nbformat
from nbclient import NotebookClient

if __name__ == "__main__":
    notebook = nbformat.read(sys.argv[1], as_version=4)
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    nbformat.write(notebook, sys.stdout)
