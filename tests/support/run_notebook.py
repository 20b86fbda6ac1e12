"""A program that runs a notebook in a new kernel, and prints it with its outputs.

It is not a function, so that Jupyter's warnings do not fail the tests.
"""

import os
import sys
import tempfile

import nbformat
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient

if __name__ == "__main__":
    notebook = nbformat.read(sys.argv[1], as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        # Unix sockets in this folder: a port may be taken before the kernel binds it.
        os.environ["JUPYTER_RUNTIME_DIR"] = folder
        kernel = AsyncKernelManager(
            kernel_name="python3", transport="ipc", ip=f"{folder}/socket"
        )
        client = NotebookClient(notebook, km=kernel, timeout=120, startup_timeout=120)
        client.execute()
    nbformat.write(notebook, sys.stdout)
