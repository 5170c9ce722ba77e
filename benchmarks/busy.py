"""Does what comes out depend on how busy the machine is?  Writes benchmarks/BUSY.md, or another FILE.md.

``run``, ``fuzz``, pytest and ``campaign`` on a small scenario, space and plan, 20 times with nothing of
ours beside them and 20 times with 8 processes that compute, by turns; each repetition in a process of its
own.  The avoiders: one in a Python file that computes with numpy for some milliseconds, in a process of its
own and without ``propose_many``, and mc-dropout.  Compared are all bits of ticks and decisions, or what the
command wrote, but for times, paths and what was measured on the wall's clock.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import contextlib
import hashlib
import io
import multiprocessing
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import run
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of
from safety_harness.extensions.assurance.commands.campaign import run as run_campaign
from safety_harness.trace.store import load_trace

OUT = Path(__file__).with_name("BUSY.md")
TIMES, BUSY = 20, (0, 8)
HANDS = """
tcp start:
  offset: [40 mm, SIDE, 60 mm]
hands:
  - hand: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [790 mm, -270 mm, 300 mm]
        speed: 1 m/s
      - wait: 5 s
"""
CLAIMS = """
claims:
  hand distance never below 20 mm: holds
  joint speeds within limits: holds
"""
SCENARIO = "scenario: a hand comes and stays\nduration: 2 s" + HANDS.replace("SIDE", "-120 mm") + CLAIMS
SPACE = (
    "scenario space: a hand comes and stays\nduration: 1.2 s"
    + HANDS.replace("SIDE", "from -140 mm to -60 mm")
    + CLAIMS
)
PLAN = """\
plan: a hand comes and stays
avoider: AVOIDER
world: PyBullet
seed: 7
strata:
  - stratum: all of them
    space: space.yaml
    runs: 6
claims:
  - claim: hand distance never below 20 mm
    violated in at most: 50 %
    hazard: a hand is crushed
"""
SLOW = """\
import numpy as np
from safety_harness import Proposal


class Slow:
    name = "some milliseconds of numpy"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        rng = np.random.default_rng(seed)
        for _ in range(12):
            np.linalg.svd(rng.normal(size=(60, 60)))
        away = tcp_position_in_base_m - hand_position_in_base_m
        return Proposal(tcp_position_in_base_m + 0.1 * away / np.linalg.norm(away) + rng.normal(0.0, 1e-3, 3))
"""
AVOIDERS = ("slow.py:Slow", "mc-dropout")


def of_run(avoider: str) -> tuple[bytes, float]:
    """Ticks and decisions, and the slowest answer [s]."""
    run([Path("scenario.yaml")], Path("out"), avoider)
    trace = load_trace(Path("out/traces/scenario.trace"))
    return values_of(trace.ticks) + values_of(trace.decisions), float(trace.decision_latency_s.max())


def values_of(records: NDArray[np.void]) -> bytes:
    """Every field in turn: what lies between the fields of a record is nobody's."""
    return b"".join(np.ascontiguousarray(records[name]).tobytes() for name in records.dtype.names or ())


def of_fuzz(avoider: str) -> tuple[bytes, float]:
    """What it writes for programs."""
    fuzz(Path("space.yaml"), out=Path("fuzz"), avoider=avoider, budget=6)
    return Path("fuzz/findings.json").read_bytes(), np.nan


def of_pytest(avoider: str) -> tuple[bytes, float]:
    """The verdicts and margins that it writes to JUnit XML."""
    pytest.main(["-q", "-p", "no:cacheprovider", "--avoider", avoider, "--junitxml=p.xml", "scenario.yaml"])
    found = re.findall(r'<property name="(?:claim|verdict|margin)" value="[^"]*"', Path("p.xml").read_text())
    assert len(found) == 6, found
    return "".join(found).encode(), np.nan


def of_campaign(avoider: str) -> tuple[bytes, float]:
    """The fingerprint of its ledger."""
    Path("plan.yaml").write_text(PLAN.replace("AVOIDER", avoider))
    run_campaign(Path("plan.yaml"), ledger=Path("ledger.sqlite"), workers=1)
    with Ledger.open(Path("ledger.sqlite")) as ledger:
        return str(fingerprint_of(ledger)).encode(), np.nan


COMMANDS: dict[str, Callable[[str], tuple[bytes, float]]] = {
    "run": of_run,
    "fuzz": of_fuzz,
    "pytest": of_pytest,
    "campaign": of_campaign,
}


def repetition(avoider: str, names: tuple[str, ...], to: multiprocessing.connection.Connection) -> None:
    """Each command once, in a folder of its own; the hashes go to the parent."""
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as quiet:
        os.chdir(folder)
        for name, text in (("scenario.yaml", SCENARIO), ("space.yaml", SPACE), ("slow.py", SLOW)):
            Path(name).write_text(text)
        for redirect in (contextlib.redirect_stdout, contextlib.redirect_stderr):
            quiet.enter_context(redirect(io.StringIO()))
        found = {}
        for name in names:
            data, slowest_s = COMMANDS[name](avoider)
            found[name] = hashlib.sha256(data).hexdigest()[:12], slowest_s
        to.send(found)
        os.chdir("/")


def once(avoider: str, names: tuple[str, ...]) -> dict[str, tuple[str, float]]:
    """A repetition in a fork, which remembers nothing of another."""
    here, there = multiprocessing.Pipe()
    child = multiprocessing.get_context("fork").Process(target=repetition, args=(avoider, names, there))
    child.start()
    there.close()
    found: dict[str, tuple[str, float]] = here.recv()
    child.join()
    return found


@contextlib.contextmanager
def beside(count: int) -> Iterator[None]:
    """So many processes that compute."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()


def tables(times: int) -> Iterator[list[str]]:
    """Markdown, a row for each command and avoider; after each repetition all so far."""
    names = tuple(COMMANDS)
    hashes: dict[tuple[str, str, int], Counter[str]] = defaultdict(Counter)
    slowest_s: dict[tuple[str, int], float] = defaultdict(float)
    for _ in range(times):
        for count in BUSY:
            with beside(count):
                for avoider in AVOIDERS:
                    for name, (digest, latency_s) in once(avoider, names).items():
                        hashes[name, avoider, count][digest] += 1
                        slowest_s[avoider, count] = max(slowest_s[avoider, count], np.nan_to_num(latency_s))
        yield list(rows(hashes, slowest_s))


def rows(
    hashes: dict[tuple[str, str, int], Counter[str]], slowest_s: dict[tuple[str, int], float]
) -> Iterator[str]:
    """The table."""
    yield "| command | avoider | 0 busy processes | 8 busy processes | identical |"
    yield "|---|---|---|---|---|"
    for (name, avoider, count), none in list(hashes.items()):
        if count == BUSY[0]:
            some = hashes[name, avoider, BUSY[1]]
            cells = (", ".join(f"{n} times {d}" for d, n in one.items()) for one in (none, some))
            same = "yes" if len(none | some) == 1 else "**no**"
            yield f"| {name} | {avoider} | {' | '.join(cells)} | {same} |"
    yield ""
    for avoider in AVOIDERS:
        words = (f"{slowest_s[avoider, count] * 1e3:.1f} ms beside {count}" for count in BUSY)
        yield f"Slowest answer of {avoider} in `run`: {', '.join(words)} busy processes."


def main() -> None:
    """The table, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, default=OUT, help="where the table goes")
    parser.add_argument("--times", type=int, default=TIMES)
    given = parser.parse_args()
    begun_s = time.perf_counter()
    once(AVOIDERS[0], tuple(COMMANDS))  # compiles
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    for number, lines in enumerate(tables(given.times), start=1):
        head = (
            f"Revision {revision}, {platform.system()} {platform.machine()}, {os.cpu_count()} CPUs, Python "
            f"{platform.python_version()}, load {os.getloadavg()[0]:.1f} at the end, "
            f"{(time.perf_counter() - begun_s) / 60.0:.0f} minutes, {number} of {given.times} repetitions."
        )
        text = "\n".join(("# Under load", "", f"Written by `make bench-busy`. {head}", "", *lines))
        print(text, flush=True)
        given.file.write_text(text + "\n")


if __name__ == "__main__":
    main()
