"""Does ``fuzz`` find in each shipped space what 500 uniform draws find?  Writes benchmarks/FOUND.md.

Both in the kinematic world, with the space's own avoider and claims.  The search has the budget that ``fuzz``
has if nobody says otherwise; what it found is counted before shrinking and confirming.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import subprocess
from pathlib import Path

from safety_harness.search.cube import Cube
from safety_harness.search.findings import Findings
from safety_harness.search.sampling import UniformSampling
from safety_harness.search.search import find_violations
from safety_harness.search.searchers import MakesSearcher, searcher_named
from safety_harness.search.trials import Trials, in_kinematic
from safety_harness.space.read import read_space

FOLDER = Path(__file__).parents[1] / "scenarios/spaces"
OUT = Path(__file__).with_name("FOUND.md")
UNIFORM, BUDGET, SEED = 500, 1_000, 0


def searched(file: Path, make: MakesSearcher, runs: int) -> tuple[Trials, Findings]:
    """A search of a space until ``runs`` runs are made."""
    trials = Trials(read_space(file), in_kinematic, seed=SEED)
    cube = Cube.of(trials.space)
    searcher = make(cube, claims=len(trials.goals), seed=SEED)
    return trials, find_violations(cube, trials.goals, trials, searcher, budget=runs, batch=64)


def rows(file: Path) -> list[str]:
    """A row a claim that the space expects to be violated, or that either violates."""
    _, uniform = searched(file, UniformSampling, UNIFORM)
    trials, found = searched(file, searcher_named("default"), BUDGET)
    lines = []
    for k, goal in enumerate(found.goals):
        if goal.sentence in trials.to_be_found or uniform.violated[k] or found.violated[k]:
            missed = "**no**" if uniform.violated[k] and not found.violated[k] else "yes"
            expected = "violated" if goal.sentence in trials.to_be_found else "holds"
            counts = f"{uniform.violated[k]} of {uniform.tried} | {found.violated[k]} of {found.tried}"
            lines.append(f"| {file.stem} | {goal.sentence} | {expected} | {counts} | {missed} |")
    touching = trials.coverage.touching
    near = f"{trials.nearest_hand_m * 1e3:+.1f} mm, touching in {touching} runs"
    return lines or [f"| {file.stem} | none (nearest hand {near}) | | 0 | 0 | yes |"]


def main() -> None:
    """All spaces; the table is written at the end."""
    git = ["git", "rev-parse", "--short", "HEAD"]
    revision = subprocess.run(git, capture_output=True, text=True, cwd=OUT.parent, check=False).stdout.strip()
    table = [row for file in sorted(FOLDER.glob("*.yaml")) for row in rows(file)]
    head = [
        "# What a search finds in the shipped spaces",
        "",
        f"`make bench-found_in_spaces`, at {revision}: violations in {UNIFORM} uniform draws, and in "
        f"a search of {BUDGET} runs, seed {SEED}, kinematic, before confirmation.",
        "",
        "| space | claim | the space expects | uniform | default search | found what uniform found |",
        "|---|---|---|---|---|---|",
    ]
    OUT.write_text("\n".join(head + table) + "\n")
    print("\n".join(table))


if __name__ == "__main__":
    main()
