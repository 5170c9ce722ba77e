"""A scenario as another folder has to write it: with the ways to its files from there."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from safety_harness.admission.avoiders import command_line_reference, with_avoider
from safety_harness.scenario.model import RecordedHand, Scenario
from safety_harness.scenario.references import file_and_name


def as_seen_from(folder: Path, scenario: Scenario) -> Scenario:
    """The scenario with its recordings, and its avoider's file, named relative to another folder."""
    before = scenario.file.parent if scenario.file else Path()
    hands = tuple(
        replace(hand, recording=Path(os.path.relpath(before / hand.recording, folder)))
        if isinstance(hand, RecordedHand)
        else hand
        for hand in scenario.hands
    )
    moved = replace(scenario, hands=hands, file=folder / "scenario.yaml")
    own_file, _ = file_and_name(scenario.avoider)
    return with_avoider(moved, command_line_reference(scenario)) if own_file else moved
