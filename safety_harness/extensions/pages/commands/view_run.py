"""Define ``safety-harness view``, which shows one stored run in 3-D or two runs side by side."""

from __future__ import annotations

import shlex
import webbrowser
from collections.abc import Sequence
from pathlib import Path

from safety_harness.base.exceptions import Place, TraceError
from safety_harness.base.whole_file import writing
from safety_harness.cli.console import AS_EXPECTED, document, next_step, result, say
from safety_harness.extensions.pages.view_page import write_view
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.judge_job import judged_run
from safety_harness.report.knowledge import measured_lines

PAGE = ".html"


def view(paths: Sequence[Path], out: Path | None, *, opens: bool) -> int:
    """Write a page that shows one or two stored runs, and return the exit code.

    If ``opens`` is true, open the page in a browser.
    """
    file = out or Path("reports/view") / f"{'-and-'.join(path.stem for path in paths)}{PAGE}"
    if file.suffix != PAGE:
        raise TraceError.of_option("--out", f"a file{PAGE}", str(file))
    runs = [(path.stem, _run(path)) for path in paths]
    if len({name for name, _ in runs}) < len(runs):
        runs = [(f"{path.parent.name}/{name}", run) for path, (name, run) in zip(paths, runs, strict=True)]
    with writing(file):
        write_view(file, runs)
    for name, run in runs:
        say(*(f"{name}: {line}" for line in measured_lines(run.trace)))
    result(str(file))
    document(page=str(file), runs=[name for name, _ in runs])
    if opens and not webbrowser.open(file.resolve().as_uri()):
        say("no browser could be opened: open the page by hand")
    next_step(shlex.join(["safety-harness", "judge", *map(str, paths), "-v"]), "every verdict")
    return AS_EXPECTED


def _run(path: Path) -> JudgedRun:
    run = judged_run(path)
    if len(run.trace.ticks) == 0:
        raise TraceError(place=Place(file=path), expected="a run with at least one tick", got="none")
    return run
