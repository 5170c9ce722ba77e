"""How long commands take from start to exit, with no machine code and with it, into START_UP.md.

Cold is a cache of its own, empty, for each command; warm the same command again, the best of five.  Seconds
of the processor are of the process and of those that it starts: on a busy machine they say more.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).parents[1]
SCENARIO = "scenarios/hand-visits-and-leaves.yaml"
AVOIDER = ("--avoider", "examples/upwards.py:Upwards")
COMMANDS = {
    "--version": ("safety_harness", "--version"),
    "--help": ("safety_harness", "--help"),
    "validate": ("safety_harness", "validate", SCENARIO, *AVOIDER),
    "run": ("safety_harness", "run", SCENARIO, *AVOIDER, "--out"),
    "pytest collection": ("pytest", "--collect-only", "-q", "examples/suites"),
}
WARM = 5  # times


def seconds(arguments: tuple[str, ...], folder: Path) -> tuple[float, float]:
    """(by the clock, of the processor) of one start of a module, which may write to ``folder``."""
    out = (str(folder / "out"),) if arguments[-1] == "--out" else ()
    before, began_s = os.times(), monotonic()
    subprocess.run(
        [sys.executable, "-m", *arguments, *out],
        cwd=ROOT,
        env=os.environ | {"SAFETY_HARNESS_CACHE": str(folder), "PYTHONDONTWRITEBYTECODE": ""},
        capture_output=True,
        check=False,  # a run whose verdicts differ is as long
    )
    after = os.times()
    used = after.children_user + after.children_system - before.children_user - before.children_system
    return monotonic() - began_s, used


def main() -> None:
    """Measure, print the table, and write it."""
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    lines = [
        "# Start to exit",
        "",
        f"At {revision}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC, Python {sys.version.split()[0]}, "
        f"{os.cpu_count()} processors, load {os.getloadavg()[0]:.1f}. Made by `make bench-start_up`.",
        "",
        "| command | cold [s] | of the processor | warm [s] | of the processor |",
        "|---|---|---|---|---|",
    ]
    for name, arguments in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            cold = seconds(arguments, Path(folder))
            warm = [seconds(arguments, Path(folder)) for _ in range(WARM)]
        best = min(one[0] for one in warm), min(one[1] for one in warm)
        lines.append(f"| {name} | {cold[0]:.1f} | {cold[1]:.1f} | {best[0]:.1f} | {best[1]:.1f} |")
        print(lines[-1], flush=True)
    (ROOT / "benchmarks" / "START_UP.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
