"""The first frame of the demo's towns, with all actors, rendered once for all tests.

It is rendered into a folder in which somebody else has laid links before, and nothing
in the folder may be changed.
"""

import atexit
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from unghost.street.street import StreetScene, write_street

SEED: Final = 0
"""The default seed of ``unghost demo``."""
LAID_LINKS: Final = ("manifest.part", "truth.part", "rgb/town-a/000000.png")
"""Names in the street's folder that were links to a file of the user at first."""
LINKED_TEXT: Final = "mine"
"""The text of that file when the links were laid."""


@dataclass(frozen=True)
class DemoStreet:
    """A street of one frame, as `write_street` wrote it.

    Attributes
    ----------
    manifest : Path
        In the folder with all other files of the street.
    progress : list of (done, all frames)
        What was reported, in order.
    linked : Path
        The file outside the folder that the links led to.
    """

    manifest: Path
    progress: list[tuple[int, int]]
    linked: Path

    @property
    def folder(self) -> Path:
        return self.manifest.parent


@cache
def demo_street() -> DemoStreet:
    """The demo's street of one frame; its files are deleted when the tests end."""
    place = TemporaryDirectory()
    atexit.register(place.cleanup)
    folder, linked = Path(place.name, "street"), Path(place.name, "private.txt")
    linked.write_text(LINKED_TEXT)
    for name in LAID_LINKS:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).symlink_to(linked)
    progress: list[tuple[int, int]] = []
    scene = StreetScene(SEED)
    manifest = write_street(folder, 1, scene, lambda *step: progress.append(step))
    return DemoStreet(manifest, progress, linked)
