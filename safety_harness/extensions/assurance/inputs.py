"""Let the core's commands ``validate``, ``explain``, ``new`` and ``schema`` handle plans."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from safety_harness.base.exceptions import StatisticsError
from safety_harness.base.extension_points import CheckedFile, InputFile
from safety_harness.scenario.codec import KeyTable
from safety_harness.scenario.kinds import FileKind
from safety_harness.scenario.model import Scenario


def _check(path: Path, inspect: Callable[[Scenario], object]) -> CheckedFile:
    """Raise an error unless a draw of every stratum of the plan in ``path`` is admissible.

    If ``certify`` will refuse the plan, a warning states this. ``inspect`` receives the simplest scenario of
    each stratum.
    """
    from safety_harness.admission.spaces import draw_admissible
    from safety_harness.cli.console import say
    from safety_harness.extensions.assurance.campaign.plan import read_packable
    from safety_harness.extensions.assurance.certification.results import refuse_hopeless
    from safety_harness.report.words import count_words

    plan = read_packable(path)
    if plan.world.program:
        plan.world.opener()  # refuses a program that does not exist, and executes nothing
    try:
        refuse_hopeless(plan)
    except StatisticsError as error:
        say(f"warning: certify refuses {error.place}: expected {error.expected}, got {error.got}")
    for stratum in plan.strata:
        draw_admissible(stratum.space, seed=0, count=1)
        inspect(plan.with_avoider(stratum.space.simplest))
    return CheckedFile(
        file=plan.file,
        words=", ".join(
            [
                count_words(len(plan.strata), "stratum", "strata"),
                count_words(plan.runs, "run", "runs"),
                count_words(len(plan.claims), "claim", "claims"),
            ]
        ),
        data={"runs": plan.runs},
        spaces=tuple(stratum.space for stratum in plan.strata),
    )


def _explain(path: Path) -> int:
    from safety_harness.extensions.assurance.commands.plans import explain_plan

    return explain_plan(path)


def _draft(space: Path | None, file: Path | None) -> int:
    from safety_harness.extensions.assurance.commands.plans import draft_plan

    return draft_plan(space, file)


def _tables() -> tuple[KeyTable, ...]:
    from safety_harness.extensions.assurance.campaign.plan_keys import TABLES

    return tuple(TABLES)


def _schema() -> dict[str, Any]:
    from safety_harness.extensions.assurance.campaign.plan_keys import PLAN, TITLE
    from safety_harness.scenario.schema import table_schema

    return table_schema(PLAN, TITLE)


PLANS = InputFile(
    words=FileKind.PLAN.words,
    command=FileKind.PLAN.command,
    check=_check,
    explain=_explain,
    draft=_draft,
    tables=_tables,
    schema=_schema,
)
