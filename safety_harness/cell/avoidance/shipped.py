"""Find the trained networks that come with the package, by their names."""

from __future__ import annotations

import os
from pathlib import Path

from safety_harness.base.shipped.contents import located
from safety_harness.scenario.files import resolved
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.references import MODEL_SUFFIX

SHIPPED = (
    *("mc-dropout", "mc-dropout-full", "deterministic", "ensemble", "optimum"),
    *("student", "student-ensemble"),
)
FOLDER = Path(__file__).resolve().parents[2] / "models"


def shipped_model(name: str) -> Path:
    """Return the file of the shipped network ``name``, an entry of ``SHIPPED``."""
    return FOLDER / f"{name}.safetensors"


def model_file(reference: str) -> Path:
    """Return the file of a network.

    ``reference`` is the name of a shipped network or the path of a file.
    """
    return shipped_model(reference) if reference in SHIPPED else Path(reference)


def network_file_of(scenario: Scenario) -> Path | None:
    """Return the file of a scenario's network.

    Return None if the avoider is not a network in the harness's own format.
    """
    if scenario.avoider in SHIPPED:
        return shipped_model(scenario.avoider)
    if scenario.avoider.endswith(MODEL_SUFFIX):
        folder = scenario.file.parent if scenario.file else Path()
        return resolved(located(folder / os.path.expanduser(scenario.avoider)))
    return None
