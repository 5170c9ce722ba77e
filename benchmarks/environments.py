"""Control ticks a second of the Gymnasium environments.  Writes benchmarks/ENVIRONMENTS.md.

Run: python benchmarks/environments.py [--turns N] [--out FILE].

One by one in both worlds, and many at once, also in two processes side by side; with random actions.  A turn
is a whole episode of every environment, with the reset to a fresh draw that ends it.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import argparse
import multiprocessing
import multiprocessing.connection
import os
import platform
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np

from safety_harness.extensions.gym.environment import HarnessEnv
from safety_harness.extensions.gym.vector import HarnessVectorEnv

OUT = Path(__file__).with_name("ENVIRONMENTS.md")
SPACE = "shipped:unseen-both"
HEAD = """\
# Environments

Written by `make bench-environments`. Revision {revision}, {machine}, load {load} at the end.
Control ticks a second on {space}, random actions, "joints" and "predicted hands" seen, a reset to a
fresh draw after each episode. The aim was 100,000 a second for many at once, on two cores.

| environments | world | ticks a second | least to greatest of {turns} episodes |
|---|---|---|---|
"""
Turn = Callable[[], float]  # ticks a second over whole episodes


def single(world: str) -> Turn:
    """One environment."""
    env = HarnessEnv(space=SPACE, world=world)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (100, 3)) * env.action_space.high

    def turn() -> float:
        begun_s, ticks, over = time.perf_counter(), 0, False
        while not over:
            *_, terminated, truncated, _ = env.step(actions[ticks % 100])
            ticks, over = ticks + 1, terminated or truncated
        env.reset()
        return ticks / (time.perf_counter() - begun_s)

    return turn


def many(lanes: int) -> Turn:
    """So many, in this process."""
    env = HarnessVectorEnv(lanes, space=SPACE)
    env.reset(seed=0)
    most = env.setting.action_space.high
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (100, lanes, 3)) * most

    def turn() -> float:
        begun_s, ticks, over = time.perf_counter(), 0, False
        while not over:
            *_, truncated, _ = env.step(actions[ticks % 100])
            ticks, over = ticks + 1, bool(truncated.all())
        return lanes * ticks / (time.perf_counter() - begun_s)

    return turn


def of_both(lanes: int) -> Turn:
    """So many in each of two processes, which begin each turn together."""
    context = multiprocessing.get_context("spawn")
    pipes = [context.Pipe() for _ in range(2)]
    for _, there in pipes:
        context.Process(target=_work, args=(there, lanes), daemon=True).start()

    def turn() -> float:
        for here, _ in pipes:
            here.send(None)
        return sum(float(here.recv()) for here, _ in pipes)

    return turn


def _work(there: multiprocessing.connection.Connection, lanes: int) -> None:
    turn = many(lanes)
    with suppress(EOFError):  # the other side has ended
        while True:
            there.recv()
            there.send(turn())


def rows(turns: int) -> Iterator[str]:
    """The table's."""
    sides: dict[str, Turn] = {
        "1 | kinematic": single("kinematic"),
        "1 | PyBullet": single("PyBullet"),
        "16 | kinematic": many(16),
        "128 | kinematic": many(128),
        "512 | kinematic": many(512),
        "2 x 128, two processes | kinematic": of_both(128),
    }
    rates: dict[str, list[float]] = {name: [] for name in sides}
    for number in range(turns + 1):
        for name, turn in sides.items():
            rate = turn()
            if number:  # the first one compiles what is not compiled
                rates[name].append(rate)
    for name, own in rates.items():
        yield f"| {name} | {np.median(own):,.0f} | {min(own):,.0f} to {max(own):,.0f} |"


def main() -> None:
    """Measure, and write the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--out", type=Path, default=OUT)
    asked = parser.parse_args()
    found = list(rows(asked.turns))
    git = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    python = f"Python {platform.python_version()}"
    head = HEAD.format(
        revision=subprocess.run(git, capture_output=True, text=True, check=True).stdout.strip(),
        machine=f"{platform.system()} {platform.machine()}, {os.cpu_count()} CPUs, {python}",
        load=f"{os.getloadavg()[0]:.1f}",
        space=SPACE,
        turns=asked.turns,
    )
    asked.out.write_text(head + "\n".join(found) + "\n", encoding="utf-8")
    print(asked.out.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
