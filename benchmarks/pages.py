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
FILTERED = """const find = document.querySelector('.filter input');
find.value = arguments[0]; find.dispatchEvent(new Event('input', { bubbles: true }));
document.body.offsetHeight"""  # with the layout
COUNTED = ("ScriptDuration", "LayoutDuration", "RecalcStyleDuration")


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


def spent(browser: Any, *names: str) -> float:
    """Milliseconds of processor time that the page's thread has spent so far on what the names say."""
    found = browser.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
    return sum(1e3 * one["value"] for one in found if one["name"] in names)


def measured(browser: Any, path: Path) -> tuple[float, float]:
    """Processor time [ms] to open it, the median of three, and to filter it by the slowest text."""
    browser.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})
    opened, filtered = [], []
    for _ in range(3):
        show(browser, path.as_uri(), width=1280)
        opened.append(spent(browser, "TaskDuration"))
    for word in WORDS:
        before = spent(browser, *COUNTED)
        browser.execute_script(FILTERED, word)
        filtered.append(spent(browser, *COUNTED) - before)
    return median(opened), max(filtered)


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
        "The runs are made up and their curves noisy. Times are processor time of the page's",
        "thread, since the machine is shared. Opened: all tasks until the load event, the median of three.",
        "Filtered: script, style and layout for the slowest of four texts.",
        "",
        "| runs | verdicts | page | opened | filtered |",
        "|---|---|---|---|---|",
        *rows,
    ]
    OUT.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
