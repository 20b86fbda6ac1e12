"""The entry points by which installed packages name formats of their own.

Nothing is imported here but their names; `filter_core.formats.registry` imports the
formats when a folder is read that may have one of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

GROUP: Final = "unghost.formats"
"""The group of these entry points. The name of each is that of its format."""


@cache
def plugin_entries() -> Sequence[EntryPoint]:
    """The entry points of all installed packages, by name and package."""
    # A tenth of the time that the library needs to be imported.
    from importlib.metadata import entry_points

    return sorted(
        entry_points(group=GROUP), key=lambda entry: (entry.name, package_of(entry))
    )


def plugin_names() -> tuple[str, ...]:
    """The names of the formats of installed packages, also of those with a fault."""
    return tuple(dict.fromkeys(entry.name for entry in plugin_entries()))


def package_of(entry: EntryPoint) -> str:
    """The package of an entry point, with its version."""
    return f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value
