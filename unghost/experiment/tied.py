"""Runs a command, which ends when the process that started this one has ended.

    python -m unghost.experiment.tied COMMAND WORD...

Its standard input is a pipe from that process, which closes when it ends, however it
ends. Otherwise a trainer would go on for hours, and write into the folder of a trial
that has been begun again.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from typing import Final

_STDIN: Final = 0


def main() -> int:
    """Run the command; returns its exit code, as a shell does."""
    # The command receives the signal, too, and ends as it wants to.
    signal.signal(signal.SIGINT, lambda *_: None)
    try:
        command = subprocess.Popen(sys.argv[1:], stdin=subprocess.DEVNULL)
    except OSError as error:
        sys.exit(f"{sys.argv[1]}: {error.strerror}")

    def end_with_parent() -> None:
        while os.read(_STDIN, 1024):
            pass
        command.kill()

    threading.Thread(target=end_with_parent, daemon=True).start()
    code = command.wait()
    return code if code >= 0 else 128 - code


if __name__ == "__main__":
    sys.exit(main())
