"""The command line `unghost`: parses options, calls the client or library, prints."""

from unghost.cli.program import main

__all__ = ["main"]
