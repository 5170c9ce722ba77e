"""What does it cost to read and validate 1,000 scenario files?  Run: python benchmarks/scenario_files.py.

The files are the shipped ones over and over, each with a seed of its own, beside the
recordings that they name: written to a folder, read and admitted, as ``safety-harness validate`` does.
"""

from __future__ import annotations

import one_thread  # noqa: F401 (before every library that reads its variables)

# isort: split

import re
import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

from safety_harness.admission.admit import admit
from safety_harness.scenario.expand import gather
from safety_harness.scenario.nodes import parse_tree

SCENARIOS = Path(__file__).parents[1] / "scenarios"
COUNT = 1_000
TURNS = 3


def write_files(folder: Path) -> list[Path]:
    """COUNT files that differ."""
    shutil.copytree(SCENARIOS / "recordings", folder / "recordings")
    texts = [text for text in _texts() if "matrix:" not in text]  # which would be several scenarios
    files = []
    for number in range(COUNT):
        text = re.sub(r"(?m)^seed: .*\n", "", texts[number % len(texts)])
        files.append(folder / f"s{number:04}.yaml")
        files[-1].write_text(f"{text.rstrip()}\nseed: {number}\n")
    return files


def _texts() -> list[str]:
    return [file.read_text() for file in sorted(SCENARIOS.glob("*.yaml"))]


def timed(function: Callable[[], object]) -> float:
    """Seconds that a call takes."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def main() -> None:
    """Print everything."""
    print(__doc__)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = write_files(folder)
        texts = [file.read_text() for file in files]
        admit(gather(files[:1]).scenarios[0])  # imports and loads what the first one needs
        parts: dict[str, list[float]] = {"YAML to a tree": [], "read (tree and scenario)": [], "admit": []}
        for _ in range(TURNS):
            gathered = gather(files)
            assert len(gathered.scenarios) == COUNT, gathered.errors[0]
            parts["YAML to a tree"].append(timed(lambda: [parse_tree(text, None) for text in texts]))
            parts["read (tree and scenario)"].append(timed(lambda: gather(files)))
            parts["admit"].append(timed(lambda found=gathered: [admit(one) for one in found.scenarios]))
        for part, seconds in parts.items():
            spread = f"({min(seconds):.2f} to {max(seconds):.2f})"
            print(f"  {part:28}{median(seconds):7.2f} s {spread:18} for {COUNT:,} files")
        total = median(a + b for a, b in zip(*list(parts.values())[1:], strict=True))
        print(f"  {'read and admit':28}{total:7.2f} s, {1e3 * total / COUNT:.1f} ms a file")


if __name__ == "__main__":
    main()
