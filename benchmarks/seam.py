"""What a controller of a user's own costs, here and elsewhere?  Writes benchmarks/SEAM.md or FILE.md.

Episodes of a kinematic campaign, drawn, admitted, run for 500 ticks and judged by two claims, with everything
(the harness, and the controller's process) on one core.  The controllers take turns; values are medians of
the turns, by the wall's clock (least to greatest) and in processor time, which a busy machine disturbs less.
*Nothing* is a controller that returns the same action at once: what is left is the harness.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import os
import platform
import shlex
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from safety_harness import Move, Seen
from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.extensions.assurance.campaign.episodes import EpisodeRunner
from safety_harness.extensions.assurance.campaign.plan import read_plan

OUT = Path(__file__).with_name("SEAM.md")
EXAMPLES = Path(__file__).parents[1] / "examples"
TICKS, TURNS, EPISODES, AIM = 500, 7, 64, 150
SHIPPED = "for comparison: the visual servo with mc-dropout, compiled"
SPACE = """\
scenario space: a hand nearby
duration: 4 s
tcp start:
  offset: [0 mm, from -40 mm to 40 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [from 700 mm to 900 mm, -500 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
    moves:
      - move to: [from 700 mm to 900 mm, -250 mm, 300 mm]
        speed: 1 m/s
claims:
  hand distance never below 30 mm: holds
  joint speeds within limits: holds
"""
PLAN = """\
plan: a hand nearby
about: what a controller costs
{system}
world: kinematic
seed: 7
strata:
  - stratum: near
    space: space.yaml
    runs: 1000
claims:
  - claim: joint speeds within limits
  - claim: hand distance never below 30 mm
"""
NOTHING = """
from safety_harness import Move
class Nothing:
    name, sees = "nothing", ("joints", "hands")
    def reset(self, **start): self.move = Move(joint_velocity_radps=[0.0] * 6)
    def act(self, seen): return self.move
"""


class Nothing:
    """The same action at once."""

    name = "nothing"
    sees = ("joints", "hands")

    def reset(self, **start: object) -> None:
        """Make it."""
        self.move = Move(joint_velocity_radps=np.zeros(6))

    def act(self, seen: Seen) -> Move:
        """That."""
        return self.move


@dataclass
class Side:
    """A controller on trial; seconds of an episode in each turn: by the wall, of this process, of its own."""

    what: str
    runner: EpisodeRunner
    here: object = None  # in this process, in place of the plan's: one episode after another
    lanes: bool = True  # or one by one
    turns: list[tuple[float, float, float]] = field(default_factory=list)

    def turn(self, episodes: Sequence[int], *, counts: bool = True) -> None:
        """So many episodes."""
        begun = time.perf_counter(), time.process_time(), self._elsewhere_s()
        if self.here is None:
            groups = [episodes] if self.lanes else [[episode] for episode in episodes]
            rows = [row for group in groups for row in self.runner.run(0, group)]
            assert not any(row.failure for row in rows), rows[0].failure
        else:
            for episode in episodes:
                self._here(episode)
        ended = time.perf_counter(), time.process_time(), self._elsewhere_s()
        wall_s, own_s, other_s = ((b - a) / len(episodes) for a, b in zip(begun, ended, strict=True))
        if counts:
            self.turns.append((wall_s, own_s, other_s))

    def rates(self) -> tuple[float, float, float]:
        """Episodes a second by the wall: median, least, greatest."""
        walls_s = [turn[0] for turn in self.turns]
        return 1 / statistics.median(walls_s), 1 / max(walls_s), 1 / min(walls_s)

    def processor_s(self) -> tuple[float, float, float]:
        """Of an episode, medians: this process, its own, and both together in the same turn."""
        here, there = [turn[1] for turn in self.turns], [turn[2] for turn in self.turns]
        both = [a + b for a, b in zip(here, there, strict=True)]
        return statistics.median(here), statistics.median(there), statistics.median(both)

    def _here(self, episode: int) -> None:
        """As a campaign does it, but with an object of this process."""
        drawn = self.runner.scenario(0, episode, 0)
        run = run_kinematic(admit(drawn, controller=self.here))  # type: ignore[arg-type]
        assert len(run.ticks) == TICKS + 1
        self.runner.row_of(0, episode, 1, run)

    def _elsewhere_s(self) -> float:
        """Processor time of the processes that this one started."""
        total = 0
        for file in Path("/proc").glob("[0-9]*/stat"):
            fields = file.read_text().rpartition(")")[2].split()
            if int(fields[1]) == os.getpid():
                total += int(fields[11]) + int(fields[12])
        return total / os.sysconf("SC_CLK_TCK")


def sides(folder: Path) -> Iterator[Side]:
    """The controllers, begun."""
    sys.path.insert(0, str(EXAMPLES))
    from stop_and_go import StopAndGo

    (folder / "space.yaml").write_text(SPACE)
    (folder / "nothing.py").write_text(NOTHING)
    python = f"controller: {EXAMPLES / 'stop_and_go.py'}:StopAndGo"
    together = f"controller: {EXAMPLES / 'stop_and_go_together.py'}:StopAndGo"
    nothing = f"controller: {folder / 'nothing.py'}:Nothing"
    ships = "controller: stop when near"
    yield Side(SHIPPED, runner_of(folder, "avoider: mc-dropout"))
    yield Side("nothing, in this process, one by one", runner_of(folder, ships), Nothing())
    yield Side("stop_and_go.py, in this process, one by one", runner_of(folder, ships), StopAndGo())
    yield Side("stop when near, one by one", runner_of(folder, ships), lanes=False)
    yield Side("stop when near, in lanes: act_many", runner_of(folder, ships))
    yield Side("nothing, a Python file, in lanes", runner_of(folder, nothing))
    yield Side("stop_and_go.py, a Python file, one by one", runner_of(folder, python), lanes=False)
    yield Side("stop_and_go.py, a Python file, in lanes", runner_of(folder, python))
    yield Side("stop_and_go_together.py, a Python file, in lanes: act_many", runner_of(folder, together))
    compiler = shutil.which("c++")
    if compiler is not None:
        program = folder / "client"
        source = str(EXAMPLES / "controllers" / "stop_and_go.cpp")
        subprocess.run([compiler, "-O2", "-o", str(program), source], check=True)
        yield Side(
            "stop_and_go.cpp, a program, one by one",
            runner_of(folder, f"controller: exec:{shlex.quote(str(program))} 0.3"),
        )


def runner_of(folder: Path, system: str) -> EpisodeRunner:
    """The episodes of a plan with that controller or avoider."""
    plan = folder / f"plan-{len(list(folder.glob('plan-*')))}.yaml"
    plan.write_text(PLAN.format(system=system))
    return EpisodeRunner(read_plan(plan))


def bare_turn_us(times: int = 5_000) -> float:
    """A turn of 500 bytes there and back between two processes that do nothing else."""
    there, back = os.pipe(), os.pipe()
    if os.fork() == 0:
        os.close(there[1])
        while found := os.read(there[0], 500):
            os.write(back[1], found)
        os._exit(0)
    begun_s = time.perf_counter()
    for _ in range(times):
        os.write(there[1], b"x" * 500)
        os.read(back[0], 500)
    took_s = time.perf_counter() - begun_s
    for end in (*there, *back):
        os.close(end)
    return took_s / times * 1e6


def table(measured: Sequence[Side]) -> Iterator[str]:
    """Of all sides."""
    yield (
        "| controller | episodes/s by the wall | episodes a second of processor "
        "| us a tick: harness | its process | together |"
    )
    yield "|---|---|---|---|---|---|"
    for side in measured:
        each_s = side.processor_s()
        ticks_us = " | ".join(f"{1e6 * one_s / (TICKS + 1):.1f}" for one_s in each_s)
        median, least, most = side.rates()
        walls = f"{median:.0f} ({least:.0f} to {most:.0f})"
        yield f"| {side.what} | {walls} | {1.0 / each_s[2]:.0f} | {ticks_us} |"
    yield ""
    bare_us = min(map(bare_turn_us, [5_000] * 5))
    yield f"A turn of a bare pipe between two processes on this core, least of five: {bare_us:.1f} us."
    yield ""
    for side in measured:
        if "act_many" in side.what:
            best = 1.0 / min(both for both in (turn[1] + turn[2] for turn in side.turns))
            met = [("met" if rate >= AIM else "NOT MET") for rate in (side.rates()[0], best)]
            yield (
                f"Aim: {AIM} episodes/s on one core, {side.what}: by the wall, median, {met[0]}; "
                f"by processor time, in the quickest turn {best:.0f}, {met[1]}; "
                f"{side.rates()[0] / measured[0].rates()[0]:.2f} of the compiled visual servo's rate."
            )


def main() -> None:
    """The table, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, default=OUT, help="where the table goes")
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--episodes", type=int, default=EPISODES, help="of a turn of those in lanes")
    given = parser.parse_args()
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})  # and all that it starts
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        measured = list(sides(Path(folder)))
        for side in measured:
            side.turn(range(2), counts=False)  # compiles, starts
        for turn in range(given.turns):
            for side in measured:
                side.turn(range(turn * given.episodes, (turn + 1) * given.episodes))
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    head = (
        f"Written by `make bench-seam`. Revision {revision}, {platform.system()} {platform.machine()}, "
        f"one core of {os.cpu_count()}, Python {platform.python_version()}, "
        f"load {load:.1f} at the beginning and {os.getloadavg()[0]:.1f} at the end; "
        f"{given.turns} turns of {given.episodes} episodes of {TICKS} ticks; lanes are episodes side by side."
    )
    text = "\n".join(("# What a controller elsewhere costs", "", head, "", *table(measured)))
    print(text)
    given.file.write_text(text + "\n")


if __name__ == "__main__":
    main()
