"""A program that runs a notebook in a new kernel, and prints it with its outputs.

It is not a function, so that Jupyter's warnings do not fail the tests.
"""

from __future__ import annotations

import sys

import nbformat
from nbclient import NotebookClient

if __name__ == "__main__":
    notebook = nbformat.read(sys.argv[1], as_version=4)
    NotebookClient(notebook, timeout=120, kernel_name="python3").execute()
    nbformat.write(notebook, sys.stdout)
