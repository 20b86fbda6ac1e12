"""An export as a folder: whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath

from filter_core.formats.export import Sink
from filter_core.formats.export_options import ExportError


@contextmanager
def folder_sink(folder: Path) -> Iterator[Sink]:
    """A sink that writes files into a new folder.

    The folder appears under its name when everything is written, and not if anything
    fails.

    Raises
    ------
    ExportError
        There is something already, or a file would not stay inside.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ExportError(f"{folder.name}: expected a new or an empty folder")
    folder.parent.mkdir(parents=True, exist_ok=True)
    partial = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}-"))
    try:
        yield _Folder(partial).write
        partial.chmod(0o755)
        if folder.exists():
            folder.rmdir()
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


class _Folder:
    def __init__(self, root: Path) -> None:
        self._root = root

    def write(self, name: str, pieces: Iterable[bytes]) -> None:
        parts = PurePosixPath(name).parts
        if not parts or parts[0] == "/" or ".." in parts or "\\" in name:
            raise ExportError(f"{name[:80]!r} is no name of a file in an export")
        path = self._root.joinpath(*parts)
        path.parent.mkdir(parents=True, exist_ok=True)
        # Exclusive: what a system takes for the same name must not be lost.
        with path.open("xb") as file:
            file.writelines(pieces)
