"""How heavy the page of many runs is, how fast it opens and is filtered, into benchmarks/PAGES.md.

The runs are made up, and noisier than real ones; chromium and chromedriver are needed.

Run: python benchmarks/pages.py [RUNS]...
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests"), str(ROOT / "tests" / "report")]

import factory  # noqa: E402
from browsing import show, started  # noqa: E402

from safety_harness.report.html import write_report  # noqa: E402

OUT = ROOT / "benchmarks" / "PAGES.md"
WORDS = ("violated", "hand distance 12", "holds", "")
OPENED = "const [t] = performance.getEntriesByType('navigation'); return t.loadEventEnd"
FILTERED = """const find = document.querySelector('.filter input'), from = performance.now();
find.value = arguments[0]; find.dispatchEvent(new Event('input', { bubbles: true }));
document.body.offsetHeight; return performance.now() - from"""  # with the layout


def write(count: int, path: Path) -> int:
    """A page of so many runs; how many verdicts it has."""
    made = [factory.holds_run(), factory.violated_run(), factory.no_hands_run()]
    runs = []
    for k in range(count):
        run = made[k % len(made)]
        scenario = replace(run.trace.scenario, name=f"{run.trace.scenario.name}-{k}", title=f"run {k}")
        trace = replace(run.trace, scenario=scenario)
        runs.append(replace(run, trace=trace, trace_file=Path(f"traces/scenario-{k}.trace")))
    when = datetime(2026, 11, 24, tzinfo=UTC)
    write_report(path, runs, title="Pages", command="benchmark", interrupted=False, generated_at=when)
    return sum(len(run.evaluations) for run in runs)


def measured(browser: Any, path: Path) -> tuple[float, float]:
    """Milliseconds to open it (median of three) and to filter it by the slowest text, with the layout."""
    opened = []
    for _ in range(3):
        show(browser, path.as_uri(), width=1280)
        opened.append(browser.execute_script(OPENED))
    return median(opened), max(browser.execute_script(FILTERED, word) for word in WORDS for _ in range(3))


def main() -> int:
    """Measure each, and write the table."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        browser = started(Path(folder) / "profile")
        for count in [int(word) for word in sys.argv[1:]] or (67, 1000, 10000):
            path = Path(folder) / f"{count}.html"
            verdicts = write(count, path)
            opened, filtered = measured(browser, path)
            size = path.stat().st_size / 1e6
            rows.append(f"| {count:,} | {verdicts:,} | {size:.1f} MB | {opened:.0f} ms | {filtered:.0f} ms |")
            print(rows[-1], flush=True)
        browser.quit()
    revision = subprocess.check_output(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, text=True).strip()
    lines = [
        "# Pages of many runs",
        "",
        f"Made by `benchmarks/pages.py` at {revision}, headless Chromium on a shared machine with two cores.",
        "The runs are made up and their curves noisy. Opened: until the load event, the median of three.",
        "Filtered: the slowest of four texts, three times each, with the layout.",
        "",
        "| runs | verdicts | page | opened | filtered |",
        "|---|---|---|---|---|",
        *rows,
    ]
    OUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
