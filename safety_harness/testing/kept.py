"""Failures as scenario files: written where a person finds them, read back and tried first next time.

Hypothesis's own database holds choices as bytes, which mean nothing once a space, a strategy or
Hypothesis has changed; a scenario file goes on meaning the same.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

from safety_harness.admission.avoiders import as_seen_from
from safety_harness.admission.claims import property_of
from safety_harness.exceptions import InputError, OutputError
from safety_harness.scenario.model import Claim, Scenario, Verdict
from safety_harness.scenario.read import read_scenario
from safety_harness.scenario.write import write_scenario
from safety_harness.testing.asserting import SafetyViolation
from safety_harness.testing.session import session
from safety_harness.testing.simulating import digest_of
from safety_harness.whole_file import write_whole

ANY = Claim(sentence="trace finite and monotone", expected=Verdict.HOLDS)  # a file has to claim something
_LONGEST = 60  # characters of a part of a path


def folder_of(test_id: str) -> Path:
    """Where the failures of a test are kept."""
    path, *names = test_id.split("::")
    return session().failures.joinpath(*path.split("/"), *map(_slug, names))


def keep(test_id: str, violation: SafetyViolation) -> Path:
    """Write the scenario of ``violation``; returns the file.  OutputError if it cannot be written."""
    folder = folder_of(test_id)
    scenario, evaluation = violation.scenario, violation.evaluation
    file = folder / f"{_slug(evaluation.sentence)}-{digest_of(scenario)[:6]}.yaml"
    claim = Claim(sentence=evaluation.sentence, expected=violation.expected)
    claims = (claim,) if _is_known(claim, scenario) else scenario.claims or (ANY,)
    moved = replace(as_seen_from(folder, scenario), claims=claims)
    head = [
        f"A failure of {test_id}",
        f"{evaluation.sentence}: {evaluation.verdict.value}, margin {evaluation.margin_text()}",
        f"avoider {violation.trace.provenance.avoider}",
        "It is tried first whenever that test runs; delete this file when it need not be any more.",
    ]
    try:
        write_whole(file, "".join(f"# {line}\n" for line in head) + write_scenario(moved))
    except OSError as error:
        raise OutputError.of(file, error) from error
    return file


def kept_for(test_id: str) -> list[tuple[Path, Scenario]]:
    """The failures that are kept of a test, in the order of their names; InputError for a spoilt file."""
    return [
        (file, read_scenario(file)) for file in sorted(folder_of(test_id).glob("*.yaml")) if file.is_file()
    ]


def _is_known(claim: Claim, scenario: Scenario) -> bool:
    """Can the sentence be read back?  That of a property that a user made need not."""
    try:
        property_of(claim, scenario)
    except InputError:
        return False
    return True


def _slug(text: str) -> str:
    short = re.sub(r"[^\w.]+", "-", text).strip("-.")[:_LONGEST] or "test"
    same = re.sub(r"[^\w.]+", "-", text) == short
    return short if same else f"{short}-{hashlib.sha256(text.encode()).hexdigest()[:6]}"
