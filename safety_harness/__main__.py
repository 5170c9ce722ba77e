"""The command ``safety-harness``, also as ``python -m safety_harness``.

No slow import comes before the ``try``, so that Ctrl-C during the imports gives no traceback either.
"""

from __future__ import annotations

import gc
import io
import os
import signal
import sys
from types import FrameType


def main() -> None:
    """Run the command line; Ctrl-C and our own errors end without a traceback."""
    gc.set_threshold(20_000)  # imported objects stay, and the search for garbage among them takes long
    try:
        _open_streams()
        _answer_as_ctrl_c()
        from safety_harness.cli.main import main as run_command

        run_command()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _answer_as_ctrl_c() -> None:
    """Let SIGTERM and SIGHUP do what Ctrl-C does, unless they are ignored; forked processes end at once."""
    own = os.getpid()

    def answer(number: int, frame: FrameType | None) -> None:
        if os.getpid() != own:
            signal.signal(number, signal.SIG_DFL)
            signal.raise_signal(number)
        handler = signal.getsignal(signal.SIGINT)
        (handler if callable(handler) else signal.default_int_handler)(number, frame)

    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, answer)


def _open_streams() -> None:
    """Replace closed standard streams by the null device, and escape characters that a stream cannot encode.

    Otherwise the next file that is opened would receive the output.
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
