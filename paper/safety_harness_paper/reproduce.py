"""``safety-harness reproduce``: the paper's tables and figures measured again, on one page beside its own."""

from __future__ import annotations

import platform
import shlex
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

from safety_harness.admission.trial import judge
from safety_harness.base.compiled import source_hash_of
from safety_harness.base.distribution import installed_version
from safety_harness.base.exceptions import InputError, ModelError, OutputError, Place, SettingsError
from safety_harness.base.pool import one_thread_each
from safety_harness.cli.console import (
    AS_EXPECTED,
    BAD_INPUT,
    DIFFERS,
    INTERRUPTED,
    document,
    explain,
    result,
    say,
)
from safety_harness.cli.progress import paced_lines
from safety_harness.report.evidence import JudgedRun
from safety_harness.report.words import count_words
from safety_harness.scenario.files import display_path
from safety_harness.trace.store import load_trace
from safety_harness_paper.document import About, write_document
from safety_harness_paper.document import document as document_of
from safety_harness_paper.part import Part
from safety_harness_paper.plan import measuring_order, parts_named
from safety_harness_paper.result import Result
from safety_harness_paper.safety import NEAREST
from safety_harness_paper.scale import Scale, scale_named
from safety_harness_paper.work import Done, Task, Workshop, in_order

PAGE, DATA, WORK = "reproduction.html", "reproduction.json", "work"
LIBRARIES = ("numpy", "numba", "torch", "pybullet")


def reproduce(
    what: Sequence[str],
    *,
    scale: str = "default",
    out: Path = Path("reports/reproduction"),
    seed: int = 0,
    jobs: int = 2,
) -> int:
    """Measure what is missing, then write page and JSON about the parts that are complete.

    One line a verdict goes to standard output.  Exit code 0; 1 if a step failed; 2 for bad input, nothing was
    measured; 130 after Ctrl-C: finished steps are kept, and the page says what is missing.
    """
    one_thread_each()
    try:
        parts, chosen = parts_named(what), scale_named(scale)
        _check(seed, jobs)
    except InputError as error:
        explain(error)
        return BAD_INPUT
    tasks = {part.name: part.tasks(chosen, seed) for part in parts}
    say(f"{len(tasks)} parts of the paper, {sum(map(len, tasks.values()))} measurements")
    workshop = Workshop(out / WORK, jobs, say)
    wanted = [task for part in measuring_order(parts) for task in tasks[part.name].values()]
    interrupted = False
    try:
        with paced_lines() as workshop.tell:
            done = workshop.run(wanted)
    except OutputError as error:
        explain(error)
        return BAD_INPUT
    except KeyboardInterrupt:
        interrupted = True
        done = {task: kept for task in in_order(wanted) if (kept := workshop.kept(task)) is not None}
    results, missing = _results(parts, chosen, tasks, done, workshop.failed)
    about = About(
        scale=chosen.name,
        seed=seed,
        trainings=chosen.seeds,
        command=_command(what, scale, display_path(out), seed, jobs),
        package_version=installed_version(),
        source_hash=source_hash_of(*Path(__file__).parent.glob("*.py")),
        software=tuple((name, metadata.version(name)) for name in LIBRARIES),
        platform=f"Python {platform.python_version()}, {platform.system()} {platform.machine()}",
        generated_at=datetime.now(UTC),
        keys=tuple((task.label, task.key) for task in in_order(wanted) if task in done),
        missing=tuple(missing),
    )
    try:
        _write(out, results, about, _nearest(done))
    except OSError as error:
        explain(OutputError.from_os_error(out, error))
        return BAD_INPUT
    document(**document_of(results, about))
    for one in results:
        result(f"{one.word.value:<24} {one.name:<12} {one.why}")
    for name, why in missing:
        say(f"missing: {name}: {why}")
    say(f"page: {out / PAGE} (for programs: {DATA})")
    if interrupted:
        again = _command(what, scale, out, seed, jobs)
        say(f"interrupted; finished steps are kept. To go on: {again}")
        return INTERRUPTED
    return DIFFERS if missing else AS_EXPECTED


def _check(seed: int, jobs: int) -> None:
    for name, value, least in (("--seed", seed, 0), ("--jobs", jobs, 1)):
        if value < least:
            raise SettingsError(
                place=Place(field=name), expected=f"a number of at least {least}", got=str(value)
            )
    if find_spec("torch") is None:
        raise ModelError(
            place=Place(field="reproduce"),
            expected="PyTorch, which training needs",
            got="none installed",
            hint="in a copy of the repository: pip install ./paper",
        )


def _results(
    parts: Sequence[Part],
    scale: Scale,
    tasks: dict[str, dict[str, Task]],
    done: dict[Task, Done],
    failed: dict[Task, str],
) -> tuple[list[Result], list[tuple[str, str]]]:
    """The parts whose measurements are all there, and the others with the reason."""
    results: list[Result] = []
    missing: list[tuple[str, str]] = []
    for part in parts:
        lost = [task for task in tasks[part.name].values() if task not in done]
        if lost:
            why = next((f"{task.label}: {failed[task]}" for task in lost if task in failed), "")
            missing.append(
                (
                    part.name,
                    why or f"{count_words(len(lost), 'measurement is', 'measurements are')} still to be made",
                )
            )
        else:
            found = {name: done[task] for name, task in tasks[part.name].items()}
            try:
                results.append(part.result(scale, found))
            except Exception as error:  # hours of measuring are not lost for one part of the page
                missing.append((part.name, f"{type(error).__name__}: {error}, a defect of safety-harness"))
    return results, missing


def _nearest(done: Mapping[Task, Done]) -> list[tuple[str, JudgedRun]]:
    """The episodes that measurements kept, each with the measurement's words."""
    found = []
    for task in in_order(done):
        file = done[task].folder / NEAREST if task in done else None
        if file is None or not file.is_file():
            continue
        try:
            trace = load_trace(file)
            found.append((task.label, JudgedRun(trace, judge(trace, file=file), "")))
        except InputError as error:
            explain(error)
    return found


def _write(out: Path, results: Sequence[Result], about: About, runs: Sequence[tuple[str, JudgedRun]]) -> None:
    from safety_harness_paper.page import write_page

    write_page(out / PAGE, results, about, runs)
    write_document(out / DATA, results, about)


def _command(what: Sequence[str], scale: str, out: Path, seed: int, jobs: int) -> str:
    command = ["safety-harness", "reproduce", *what, "--scale", scale, "--out", str(out)]
    return shlex.join([*command, "--seed", str(seed), "--jobs", str(jobs)])
