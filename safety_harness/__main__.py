"""The command ``safety-harness``, also as ``python -m safety_harness``.

Nothing heavy is imported before the ``try``: Ctrl-C while libraries load is no traceback either.
"""

from __future__ import annotations

import gc
import io
import os
import sys


def main() -> None:
    """Run the command line; neither Ctrl-C nor one of our own errors ends in a traceback."""
    gc.set_threshold(20_000)  # most that is imported stays, and to look for garbage in it takes long
    try:
        _open_streams()
        from safety_harness.cli.main import main as run_command

        run_command()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _open_streams() -> None:
    """What was closed by who called goes nowhere, or the next file to be opened would get what is printed.

    What a stream's encoding has no letter for is escaped.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, number, inheritable=True)
            if null != number:
                os.close(null)
            setattr(sys, name, open(number, "r" if number == 0 else "w", encoding="utf-8"))  # noqa: SIM115
        elif number and isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


if __name__ == "__main__":
    main()
