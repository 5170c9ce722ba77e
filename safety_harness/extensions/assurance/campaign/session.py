"""Run a campaign to its end with one runner and its workers.

The campaign starts from its beginning, or continues after an interruption.
"""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.base.exceptions import described
from safety_harness.cell.simulation.worlds import named_by_user
from safety_harness.extensions.assurance.campaign.episodes import trace_of
from safety_harness.extensions.assurance.campaign.identity import unpacked
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import only_runner
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan
from safety_harness.extensions.assurance.campaign.processes import (
    LIMITS,
    Limits,
    Processes,
    WorkerPool,
    bench_of_file,
)
from safety_harness.extensions.assurance.campaign.ready import refuse_unready
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner
from safety_harness.trace.provenance import machine as kind_of_machine

LEDGER = "ledger.sqlite"
MakesCrew = Callable[[Plan], WorkerPool]


def processes(workers: int | None = None, limits: Limits = LIMITS) -> MakesCrew:
    """Return a function that makes worker processes on this machine.

    The number of processes is ``workers``, or the number of cores if ``workers`` is None.
    """
    size = workers or len(os.sched_getaffinity(0))
    return lambda plan: Processes(partial(bench_of_file, plan.file.resolve(), plan.identity), size, limits)


def run_missing(
    plan: Plan,
    path: Path,
    make_crew: MakesCrew,
    *,
    on_progress: Callable[[CampaignRunner], None] = lambda runner: None,
    enough: Callable[[], bool] = lambda: False,
    part: tuple[int, int] = (0, 1),
    say: Callable[[str], None] = lambda line: None,
) -> bool:
    """Run the missing episodes of a ledger, and create the ledger if it is missing.

    If the plan has changed and the ledger has no runs yet, the function replaces the ledger by a new ledger.
    At the end, a second avoider answers some of the queries again, and the ledger stores the result. If no
    episode is missing, the queries come from the stored runs.

    Args:
        plan: The plan.
        path: The file of the ledger.
        make_crew: A function that makes the workers, such as the result of ``processes``.
        on_progress: A callback, which receives the runner after each commit.
        enough: A function that returns True if the session should end early.
        part: A pair (k, n). The session runs only every n-th episode, beginning with episode k.
        say: A callback, which receives a line of text for the user.

    Returns:
        Whether the campaign is complete.

    Raises:
        InputError: The plan causes an error, an avoider cannot be made, or the world is not installed. In the
            last two cases no new ledger is created.
        LedgerError: The ledger belongs to another plan, or another runner uses it.
        CampaignError: The workers cannot run any more episodes.
        OutputError: The ledger cannot be written.

    """
    named_by_user(plan.world)
    with ExitStack() as stack:
        stack.enter_context(only_runner(path))
        known = _known(path, plan)
        if known is not None:
            ledger = stack.enter_context(known)
            ledger.refuse_other_plan(plan)
            if all(next(ledger.missing(k), None) is None for k in range(len(plan.strata))):
                _ask_again(plan, ledger, say)
                return True
        refuse_unready(plan)
        if known is None:
            ledger = stack.enter_context(Ledger.create(path, plan))
        elif plan.world.program:  # may have imported other files, which no hash covers, in earlier sessions
            _ask_again(plan, ledger, lambda line: None)
        crew = stack.enter_context(closing(make_crew(plan)))
        machine = f"{platform.node()}, {processor()}, {kind_of_machine()}"
        ledger.begin_session(datetime.now(UTC).isoformat(), f"{crew.size}", machine)
        runner = CampaignRunner(plan, ledger, crew, on_progress=on_progress, enough=enough, part=part)
        complete = runner.run()
        ledger.note_repeated(_checked(runner.repeatability.check))
        return complete


carry_on = run_missing  # deprecated: the old name, for one release


def _ask_again(plan: Plan, ledger: Ledger, say: Callable[[str], None]) -> None:
    """Send the queries of stored runs to the avoider again.

    Record the result in the ledger only if an answer differs. The ledger may belong to a report, and the
    report should not change without need.
    """
    ((count, *ends),) = ledger.all(
        "SELECT (SELECT count(*) FROM episode), min(began), max(began) FROM session"
    )
    days = dict.fromkeys(f"{datetime.fromisoformat(began):%-d %B %Y}" for began in ends if began)
    say(f"no new runs: all {count} episodes are of {' to '.join(days) or 'an unknown day'}")

    def check() -> RepeatabilityResult:
        repeatability = Repeatability()
        for stratum, episode, _ in ledger.traces():
            repeatability.add(trace_of(plan, stratum, ledger.trace(stratum, episode) or b""))
        return repeatability.check()

    result = _checked(check)
    if result.asked or result.words:
        say(result.line)
    if result.differing:
        ledger.note_repeated(result)


def _checked(check: Callable[[], RepeatabilityResult]) -> RepeatabilityResult:
    """Return the result of ``check``.

    If ``check`` raises an error, return a result with the error as a text, so that no run is lost.
    """
    try:
        return check()
    except Exception as error:  # a user's program may raise anything
        return RepeatabilityResult(questions=0, words=f"repeatability cannot be checked: {described(error)}")


def _known(path: Path, plan: Plan) -> Ledger | None:
    """Return the ledger at ``path``, opened for writing, or None if there is no file.

    If the ledger belongs to another plan and has no runs, delete the ledger and return None.
    """
    if not path.exists():
        return None
    ledger = Ledger.open(path, write=True)
    changed = ledger.declared.identity.changes(plan.identity)
    if not changed or next(ledger.all("SELECT 1 FROM episode LIMIT 1"), None):
        return ledger
    ledger.close()
    path.unlink()
    return None


@contextmanager
def plan_of(ledger: Ledger) -> Iterator[Plan]:
    """Yield the plan of ``ledger``.

    The plan is read from its own file, or from the ledger's copy if the file no longer exists. Raise
    LedgerError with the list of changes if the plan has changed.
    """
    file = ledger.declared.plan_file
    with ExitStack() as stack:
        plan = read_plan(file) if file.is_file() else stack.enter_context(copied_plan_of(ledger))
        ledger.refuse_other_plan(plan)
        yield plan


@contextmanager
def copied_plan_of(ledger: Ledger) -> Iterator[Plan]:
    """Yield the plan from the copies of its files in ``ledger``, even if the original files have changed.

    Raise InputError if the present program cannot read the copies.
    """
    with tempfile.TemporaryDirectory(prefix="safety-harness-") as folder:
        yield read_plan(unpacked(ledger.files, Path(folder)))


def processor() -> str:
    """Return the processor's name.

    Processors of one family give results that are equal bit for bit.
    """
    lines: list[str] = []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or "unknown processor")
