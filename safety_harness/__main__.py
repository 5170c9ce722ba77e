"""The command ``safety-harness``, also as ``python -m safety_harness``.

Nothing heavy is imported before the ``try``: Ctrl-C while libraries load is no traceback either.
"""

from __future__ import annotations


def main() -> None:
    """Run the command line; neither Ctrl-C nor one of our own errors ends in a traceback."""
    try:
        from safety_harness.cli.main import main as run_command

        run_command()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


if __name__ == "__main__":
    main()
