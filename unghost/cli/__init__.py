"""The command line: `unghost`. Parses, calls, prints; it decides nothing."""

from unghost.cli.program import main

__all__ = ["main"]
