"""Client of Unghost, which finds the boxes that CARLA's camera cannot see.

Each name is imported on first use: importing this package loads nothing, creating a
`Client` loads httpx, and reading a response pydantic. The server, numpy and OpenCV are
not loaded.

The names are those that `__init__.pyi` imports.
"""

from unghost.lazy import imports_of_stub

__getattr__, __dir__ = imports_of_stub(__name__)
