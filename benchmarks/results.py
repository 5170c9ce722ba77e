"""The table of ratios: run what offers ratios, print the table and write it to RESULTS.md.

Run: python benchmarks/results.py [NAME]..., or python benchmarks/results.py --against REVISION.

Each benchmark runs in a process of its own.  Ratios are formed between sides that take turns, so that they
bear a busy machine better than seconds do; the load stands beside them all the same.  All of them together
have LIMIT_S.  A script that has not ended by then is killed, and its row says so.  With names only those run,
and nothing is written.  With --against nothing is run: the table of a revision (HEAD, say) is compared with
the one that is there, and the exit code is 1 if a ratio got worse.
"""

from __future__ import annotations

import datetime
import json
import os
import platform
import re
import signal
import subprocess
import sys
import time
from dataclasses import asdict
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ratios import Ratio, shown

sys.path.insert(0, str(Path(__file__).parents[1]))

from safety_harness.extensions.assurance.campaign.session import processor

HERE = Path(__file__).parent
RESULTS = HERE / "RESULTS.md"
LIMIT_S = 20 * 60  # of all benchmarks together
BENCHMARKS = (
    "loop",
    "decision",
    "formulas",
    "kinematic",
    "overhead",
    "training",
    "dataset",
    "isolation",
    "campaign",
)
LIBRARIES = ("numpy", "numba", "pybullet", "torch", "rtamt", "onnxruntime")
HEAD = """\
# Ratios

Written by `make bench`. A ratio is formed within each turn of two sides that take turns on the same work,
and given as median (least to greatest) of the turns; more than one means that ours is quicker, but where the
aim says "at most", or the row names two others. How each is measured is said at the top of its script. Notes
are of a machine as busy as `load` says (processes that wanted to run, before and after); compare ratios, not
seconds. From start to exit: `START_UP.md`; what an installation weighs: `docs/how-to/install.md`.

"""


def measured(name: str, within_s: float = LIMIT_S) -> list[Ratio]:
    """Return what a script's ``ratios()`` gives, or one row that says why it gives nothing.

    The script runs in a process of its own.  After ``within_s`` it is killed, with the processes that it
    started.
    """
    command = [sys.executable, __file__, "--json", name]
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, start_new_session=True, **piped) as script:
        try:
            out, errors = script.communicate(timeout=max(within_s, 0.0))
        except subprocess.TimeoutExpired:
            os.killpg(script.pid, signal.SIGKILL)
            return [Ratio.missing(name, f"not done after {LIMIT_S // 60} minutes of all benchmarks")]
    if script.returncode != 0:
        last = (errors.strip().splitlines() or ["it ended without a word"])[-1]
        return [Ratio.missing(name, last)]
    return [Ratio(**row) for row in json.loads(out.splitlines()[-1])]


def load() -> str:
    """The load averages of one minute, or a dash where there are none."""
    return f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "-"


def revision() -> str:
    """Return the abbreviated revision of this checkout, with -dirty where files differ from it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(command, capture_output=True, text=True, cwd=HERE).stdout.strip() or "no revision"


def row_of(ratio: Ratio, script: str, loads: str) -> str:
    """A line of the table."""
    value = spread = "-"
    if ratio.verdict != "not measured":
        value, spread = shown(ratio.value), f"{shown(ratio.least)} to {shown(ratio.greatest)}"
    cells = (ratio.what, value, spread, ratio.aimed, ratio.verdict, ratio.note, loads, f"`{script}.py`")
    return "| " + " | ".join(cells) + " |"


def table(rows: list[tuple[Ratio, str, str]]) -> str:
    """RESULTS.md from (ratio, script, load before and after)."""
    versions = []
    for library in LIBRARIES:
        try:
            versions.append(f"{library} {version(library)}")
        except PackageNotFoundError:
            versions.append(f"{library} not installed")
    where = (
        f"At {revision()}, {datetime.datetime.now(datetime.UTC):%Y-%m-%d}, "
        f"{platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} cores of {processor()}, Python {platform.python_version()}; "
        f"{', '.join(versions)}.\n\n"
    )
    head = "| what | ratio | turns | aim | | | load | script |\n|---|---|---|---|---|---|---|---|\n"
    return HEAD + where + head + "".join(row_of(*row) + "\n" for row in rows)


def read(text: str) -> dict[str, Ratio]:
    """The rows of a RESULTS.md by what they are about; those that were not measured are left out."""
    rows = {}
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split(" | ")]
        turns = re.fullmatch(r"([\d.,e+-]+) to ([\d.,e+-]+)", cells[2]) if len(cells) == 8 else None
        if turns is not None:
            value, least, greatest = (float(c.replace(",", "")) for c in (cells[1], *turns.groups()))
            rows[cells[0]] = Ratio(cells[0], value, least, greatest, at_most=cells[3].startswith("at most"))
    return rows


def changes(before: dict[str, Ratio], now: dict[str, Ratio]) -> tuple[list[str], bool]:
    """Ratios none of whose turns are among those of before, in words, and whether any of them is worse.

    A ratio that is gone is worse.
    """
    lines, worse = [], False
    for what, old in before.items():
        new = now.get(what)
        if new is None:
            lines.append(f"gone: {old}")
        elif new.least > old.greatest or new.greatest < old.least:
            better = (new.value < old.value) == old.at_most
            lines.append(f"{'better' if better else 'WORSE'}: {new}; before {shown(old.value)}")
        else:
            continue
        worse = worse or not lines[-1].startswith("better")
    return lines + [f"new: {now[what]}" for what in now if what not in before], worse


def compare(revision: str) -> int:
    """Print what changed since a revision; 1 if anything got worse, 2 if there is no such table."""
    command = ["git", "show", f"{revision}:./{RESULTS.name}"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=HERE)
    if done.returncode != 0:
        print(f"expected a revision with {RESULTS.name}; got {revision}", file=sys.stderr)
        return 2
    lines, worse = changes(read(done.stdout), read(RESULTS.read_text(encoding="utf-8")))
    print("\n".join(lines) or "no ratio changed by more than the spread of its turns")
    return int(worse)


def main(arguments: list[str]) -> int:
    """Run, print the table and each script's minutes, and write the table if all ran; 1 if one failed."""
    if arguments[:1] == ["--json"]:
        rows = import_module(arguments[1]).ratios()
        print(json.dumps([asdict(row) for row in rows]))
        return 0
    if arguments[:1] == ["--against"] and len(arguments) == 2:
        return compare(arguments[1])
    names = arguments or list(BENCHMARKS)
    if unknown := set(names) - set(BENCHMARKS):
        print(f"expected names of {', '.join(BENCHMARKS)}; got {', '.join(sorted(unknown))}", file=sys.stderr)
        return 2
    found: list[tuple[Ratio, str, str]] = []
    began_s = time.monotonic()
    for name in names:
        before, since_s = load(), time.monotonic()
        rows = measured(name, LIMIT_S - (since_s - began_s))
        loads = f"{before} to {load()}"
        found += [(row, name, loads) for row in rows]
        print(f"{name}: {(time.monotonic() - since_s) / 60:.1f} minutes", file=sys.stderr, flush=True)
        if not arguments:
            RESULTS.write_text(table(found), encoding="utf-8")
    print(table(found), end="")
    return int(any(ratio.verdict == "not measured" and ratio.what == name for ratio, name, _ in found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
