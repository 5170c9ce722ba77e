"""A campaign from beginning to end, or from where it was left: one runner, its ledger and its crew."""

from __future__ import annotations

import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from safety_harness.admission.admit import refuse_no_answer
from safety_harness.admission.repeatability import Repeatability, RepeatabilityResult
from safety_harness.base.compiled import code_in_use
from safety_harness.base.exceptions import described
from safety_harness.extensions.assurance.campaign.episodes import trace_of
from safety_harness.extensions.assurance.campaign.identity import unpacked
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.opening import only_runner
from safety_harness.extensions.assurance.campaign.plan import Plan, read_plan, scenarios_by_avoider
from safety_harness.extensions.assurance.campaign.processes import (
    LIMITS,
    Limits,
    Processes,
    WorkerPool,
    bench_of_file,
)
from safety_harness.extensions.assurance.campaign.runner import CampaignRunner

LEDGER = "ledger.sqlite"
MakesCrew = Callable[[Plan], WorkerPool]


def processes(workers: int | None = None, limits: Limits = LIMITS) -> MakesCrew:
    """A crew on this machine: as many processes as cores, if not said otherwise."""
    size = workers or len(os.sched_getaffinity(0))
    return lambda plan: Processes(partial(bench_of_file, plan.file.resolve(), plan.identity), size, limits)


def carry_on(
    plan: Plan,
    path: Path,
    make_crew: MakesCrew,
    *,
    on_progress: Callable[[CampaignRunner], None] = lambda runner: None,
    enough: Callable[[], bool] = lambda: False,
    part: tuple[int, int] = (0, 1),
    say: Callable[[str], None] = lambda words: None,
) -> bool:
    """Run what is missing in the ledger at ``path``, which is made if it is not there; is it complete now?

    A ledger in which nothing was run is begun anew when the plan has changed since.  InputError before there
    is one for an avoider that cannot be made, or a world that is not installed.  LedgerError if it is another
    plan's, or if another runner is at work on it; otherwise as ``CampaignRunner.run``.  At the end a second
    avoider is asked some of the questions again; what it answers stands in the ledger.  Where nothing is
    missing ``say`` is told so first, and the questions are those of the stored runs.
    """
    with ExitStack() as stack:
        stack.enter_context(only_runner(path))
        known = _known(path, plan)
        if known is not None:
            ledger = stack.enter_context(known)
            ledger.refuse_other_plan(plan)
            if all(next(ledger.missing(k), None) is None for k in range(len(plan.strata))):
                _ask_again(plan, ledger, say)
                return True
        plan.world.opener()
        for scenario in scenarios_by_avoider(plan):
            refuse_no_answer(scenario)
        if known is None:
            ledger = stack.enter_context(Ledger.create(path, plan))
        crew = stack.enter_context(closing(make_crew(plan)))
        machine = f"{platform.node()}, {platform.machine()}, {processor()}, {code_in_use()}"
        ledger.begin_session(datetime.now(UTC).isoformat(), f"{crew.size}", machine)
        runner = CampaignRunner(plan, ledger, crew, on_progress=on_progress, enough=enough, part=part)
        complete = runner.run()
        ledger.note_repeated(_checked(runner.repeatability.check))
        return complete


def _ask_again(plan: Plan, ledger: Ledger, say: Callable[[str], None]) -> None:
    """What was asked in stored runs; a ledger, maybe a report's, is written for other answers alone."""
    ((count, *ends),) = ledger.all(
        "SELECT (SELECT count(*) FROM episode), min(began), max(began) FROM session"
    )
    days = dict.fromkeys(f"{datetime.fromisoformat(one):%-d %B %Y}" for one in ends if one)
    say(f"nothing was run: all {count} episodes are of {' to '.join(days) or 'an unknown day'}")

    def check() -> RepeatabilityResult:
        repeatability = Repeatability()
        for stratum, episode, _ in ledger.traces():
            repeatability.add(trace_of(plan, stratum, ledger.trace(stratum, episode) or b""))
        return repeatability.check()

    found = _checked(check)
    if found.asked or found.words:
        say(found.line)
    if found.differing:
        ledger.note_repeated(found)


def _checked(check: Callable[[], RepeatabilityResult]) -> RepeatabilityResult:
    """What comes out of it; if it fails, which is no reason to lose the runs, that it did."""
    try:
        return check()
    except Exception as error:  # also of a user's program
        return RepeatabilityResult(questions=0, words=f"repeatability cannot be checked: {described(error)}")


def _known(path: Path, plan: Plan) -> Ledger | None:
    """The ledger at ``path``, to be written; None for none, or another plan's in which nothing was run."""
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
    """The plan that a ledger was begun with: its own file if that is still there, else the ledger's copy.

    LedgerError that names what has changed since.
    """
    file = ledger.declared.plan_file
    with ExitStack() as stack:
        plan = read_plan(file) if file.is_file() else stack.enter_context(copied_plan_of(ledger))
        ledger.refuse_other_plan(plan)
        yield plan


@contextmanager
def copied_plan_of(ledger: Ledger) -> Iterator[Plan]:
    """The plan as the ledger's own copy of its files has it, whatever became of them since; InputError."""
    with tempfile.TemporaryDirectory(prefix="safety-harness-") as folder:
        yield read_plan(unpacked(ledger.files, Path(folder)))


def processor() -> str:
    """What the machine calls its processor; results are bit for bit the same within a family of these."""
    lines: list[str] = []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(errors="replace").splitlines()
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or "unknown processor")
