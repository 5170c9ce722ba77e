"""The command ``safety-harness``, also started by ``python -m safety_harness``.

All slow imports come after the ``try``, so that even Ctrl-C during an import causes no traceback.
"""

from __future__ import annotations

import gc
import io
import os
import sys


def main() -> None:
    """Run the command line, and end without a traceback after Ctrl-C or an error of the harness."""
    gc.set_threshold(20_000)  # imported objects stay, so searching them for garbage would only take time
    try:
        _open_streams()
        from safety_harness.base.interrupts import answer_as_ctrl_c

        answer_as_ctrl_c()
        from safety_harness.cli.main import main as run_command

        run_command()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _open_streams() -> None:
    """Replace closed standard streams by the null device, and escape characters that a stream cannot encode.

    If a standard stream stayed closed, the next opened file would get its number and receive its output.
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
