"""How long do pages of many runs take to open and to search?  Writes benchmarks/BIG_PAGES.md.

Run: python benchmarks/big_pages.py [FILE.md] [--runs N]...

Runs are copies of three of the tests' own, under other names.  A page is opened five times in a browser
and a word typed into its filter: the median of the times until it is laid out, and of those of the first
search, which reads every row, and of later ones.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests"), str(ROOT / "tests" / "report")]

import factory  # noqa: E402
from browsing import show, started  # noqa: E402

from safety_harness.extensions.pages.run_page import write_report  # noqa: E402
from safety_harness.report.evidence import JudgedRun  # noqa: E402

OUT = ROOT / "benchmarks" / "BIG_PAGES.md"
RUNS, OPENED = (67, 1_000, 10_000), 5
OPEN_MS = """document.body.offsetHeight;
return performance.getEntriesByType("navigation")[0].loadEventEnd"""
SEARCH_MS = """const find = document.querySelector("form.filter input"), taken = [];
for (const word of ["again-7", "again-1", "inconclusive", "nothing of it", ""]) {
  const begun = performance.now();
  find.value = word;
  find.form.dispatchEvent(new Event("input"));
  document.body.offsetHeight;
  taken.push(performance.now() - begun);
}
return taken"""


def runs_of(count: int) -> Iterator[JudgedRun]:
    """So many, each of a name of its own."""
    made = [factory.holds_run(), factory.violated_run(), factory.no_hands_run()]
    for k in range(count):
        run = made[k % len(made)]
        named = replace(
            run.trace.scenario,
            name=f"{run.trace.scenario.name}-{k}",
            title=f"{run.trace.scenario.title} again-{k}",
        )
        yield replace(
            run, trace=replace(run.trace, scenario=named), trace_file=Path(f"reports/run-{k}.trace")
        )


def measured(browser: Any, page: Path) -> tuple[float, float, float]:
    """Milliseconds: to open it, of the first search, of the slowest of later ones; medians."""
    opened, first, later = [], [], []
    for _ in range(OPENED):
        show(browser, page.as_uri(), width=1280)
        opened.append(browser.execute_script(OPEN_MS))
        one, *others = browser.execute_script(SEARCH_MS)
        first.append(one)
        later.append(max(others))
    return statistics.median(opened), statistics.median(first), statistics.median(later)


def main() -> None:
    """The table, printed and written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", nargs="?", type=Path, default=OUT, help="where the table goes")
    parser.add_argument("--runs", type=int, action="append")
    given = parser.parse_args()
    revision = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False, cwd=ROOT
    ).stdout.strip()
    lines = [
        "# Pages of many runs",
        "",
        f"Written by `make bench-big_pages` at {revision}; Chromium, 1280 px; medians of {OPENED}.",
        f"Load of the machine as it began: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors.",
        "",
        "| runs | verdicts | MB | open, ms | first search, ms | later searches, at most, ms |",
        "|---:|---:|---:|---:|---:|---:|",
    ]
    with tempfile.TemporaryDirectory() as folder:
        browser = started(Path(folder) / "profile")
        browser.set_page_load_timeout(300)
        for count in given.runs or RUNS:
            page, runs = Path(folder) / f"{count}.html", list(runs_of(count))
            said = {"title": "Many runs", "command": "safety-harness run scenarios", "interrupted": False}
            write_report(page, runs, generated_at=datetime.now(UTC), **said)  # type: ignore[arg-type]
            verdicts = sum(len(run.trace.scenario.claims) for run in runs)
            megabytes = page.stat().st_size / 1e6
            opened, first, later = measured(browser, page)
            lines.append(
                f"| {count:,} | {verdicts:,} | {megabytes:.1f} | {opened:.0f} | {first:.0f} | {later:.0f} |"
            )
            print(lines[-1], flush=True)
        browser.quit()
    given.file.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
