"""Work on plans before their runs: explain the best result that a plan can have, and draft plans."""

from __future__ import annotations

import json
import os
import re
import shlex
from pathlib import Path

from safety_harness.base.exceptions import InputError, OutputError, Place
from safety_harness.base.shipped.contents import located
from safety_harness.base.whole_file import writing
from safety_harness.cli.console import AS_EXPECTED, document, result, say
from safety_harness.extensions.assurance.campaign.pilot import aim_of
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.certification.verdicts import confidence_words, percent
from safety_harness.extensions.assurance.statistics.binomial import ends_of
from safety_harness.extensions.assurance.statistics.planning import Aim, allowed_violations, runs_needed
from safety_harness.scenario.model import Verdict
from safety_harness.space.read import read_space

TARGET = 0.02  # of a draft; the author, who knows the hazard, replaces it


def explain_plan(path: Path) -> int:
    """Print the best result that a plan's runs can show, and return the exit code.

    ``path`` is the plan's file.
    """
    plan = read_plan(path)
    family = ends_of(len(plan.claims), len(plan.strata))
    result(f"{plan.file}: {plan.title}; {plan.world}, seed {plan.seed}")
    each = confidence_words(1.0 - (1.0 - plan.confidence) / family)
    result(
        f"{family} bounds hold together with {percent(plan.confidence)} confidence, each alone with {each}"
    )
    for hazard in plan.risks.hazards:
        result(f"{hazard.name}: {'; '.join(hazard.derived(plan.risks.graph).steps)}")
    claims: list[dict[str, object]] = []
    for claim in plan.claims:
        aim = None if claim.target is None else aim_of(plan, claim.target)
        needed = None if aim is None else runs_needed(aim)
        target = "no target: estimated only"
        if claim.target is not None:
            target = f"violated in at most {percent(claim.target)}: needs {needed} tested runs in a stratum"
        result(f"{claim.sentence}: {target}")
        for stratum in plan.strata:
            allowed = None if aim is None else allowed_violations(aim, stratum.runs)
            many = (
                "too few even if all test it"
                if allowed is None
                else f"{allowed} may violate it if all test it"
            )
            result(f"  {stratum.name}: {stratum.runs} runs{'' if aim is None else f': {many}'}")
            claims.append(
                {
                    "claim": claim.sentence,
                    "target": claim.target,
                    "stratum": stratum.name,
                    "runs": stratum.runs,
                    "needed_tested": needed,
                    "allowed_violations": allowed,
                }
            )
    document(plan=plan.title, runs=plan.runs, bounds=family, claims=claims)
    say(f"next: safety-harness campaign pilot {shlex.quote(str(path))} forecasts tested runs of each claim")
    return AS_EXPECTED


def draft_plan(space: Path | None, file: Path | None) -> int:
    """Write a plan for the claims of a space, with the fewest runs that can show ``TARGET``.

    Args:
        space: The space. If ``space`` is None, the function raises an error
            that asks for a space.
        file: The plan to write. The default is NAME-plan.yaml in the working
            directory, where NAME is the name of the space.

    Returns:
        The exit code.

    Raises:
        InputError: The space has no claim that should hold.
        OutputError: The file exists already.

    """
    if space is None:
        expected = "the space to draft a plan of: safety-harness new plan SPACE"
        raise InputError(place=Place(field="space"), expected=expected, got="none")
    read = read_space(located(space))
    claims = [item for item in read.simplest.claims if item.expected is not Verdict.VIOLATED]
    if not claims:
        expected = "a space with a claim that is expected to hold"
        raise InputError(place=Place(file=space), expected=expected, got="none")
    path = file or Path(f"{read.name}-plan.yaml")
    if path.exists() or path.is_symlink():
        raise OutputError.of_file(path, "a path without a file", "an existing file")
    named = str(space)
    if not named.startswith("shipped:"):
        named = os.path.relpath(space, path.parent)
    runs = runs_needed(Aim(target=TARGET, family=ends_of(len(claims), 1)))
    lines = [
        f"plan: {_scalar(read.title)}",
        "about: >",
        "  State here the reason, the intended use and the assumptions.",
        "confidence: 95 %",
        "seed: 1  # better a seed from the assessor",
        "strata:",
        f"  - stratum: {_scalar(read.name.replace('-', ' '))}",
        f"    space: {_scalar(named)}",
        f"    runs: {runs}  # the fewest, if all test each claim without a violation; see campaign pilot",
        "claims:",
    ]
    for item in claims:
        lines += [
            f"  - claim: {_scalar(item.sentence)}",
            f"    violated in at most: {100 * TARGET:g} %  # your target, from the risk of the task",
        ]
    with writing(path), path.open("x", encoding="utf-8") as stream:
        stream.write("\n".join(lines) + "\n")
    read_plan(path)
    document(files=[path])
    result(f"wrote {path}")
    quoted = shlex.quote(str(path))
    commands = ("explain", "campaign pilot", "certify declare", "certify")
    say("next:", *(f"  safety-harness {item} {quoted}" for item in commands))
    return AS_EXPECTED


def _scalar(text: str) -> str:
    """Return ``text`` as a YAML scalar, in quotes if YAML could read it as another type."""
    return text if re.fullmatch(r"[A-Za-z][\w .,/-]*", text) else json.dumps(text, ensure_ascii=False)
