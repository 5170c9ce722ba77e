"""Mistakes of the user's, in the words that pytest prints, and those that can be told before any test."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from safety_harness.exceptions import InputError, Place
from safety_harness.scenario.model import OffsetStart, Scenario


def explained(error: BaseException) -> str:
    """Where, what was expected, what came, the hint; and the line of the test that asked."""
    if isinstance(error, InputError):
        lines = [str(error.place), f"  expected {error.expected}", f"  got      {error.got}"]
        lines += [f"  hint     {error.hint}"] if error.hint else []
    else:
        lines = [str(error)]
    lines += [f"  {note}" for note in getattr(error, "__notes__", [])]
    return "\n".join(lines).replace(f"{Path.cwd()}{os.sep}", "")


def refuse_unusable_avoider(reference: str) -> None:
    """UsageError for an ``--avoider`` that there is not, that does not import or that is none."""
    from safety_harness.admission.avoiders import resolve_avoider

    plain = Scenario(
        name="avoider",
        title="an avoider that is to be made",
        about="",
        duration_s=1.0,
        seed=0,
        start=OffsetStart(offset_in_base_m=(0.0, 0.0, 0.0)),
        hands=(),
        avoider=reference,
        claims=(),
    )
    try:
        resolve_avoider(reference, plain, folder=None, place=Place(field="--avoider"))
    except InputError as error:
        raise pytest.UsageError(explained(error)) from None
