"""The trained networks that come with the package, by name."""

from __future__ import annotations

from pathlib import Path

SHIPPED = (
    *("mc-dropout", "mc-dropout-full", "deterministic", "ensemble", "optimum"),
    *("student", "student-ensemble"),
)
FOLDER = Path(__file__).resolve().parents[2] / "models"


def shipped_model(name: str) -> Path:
    """The file of the shipped network called ``name``, one of ``SHIPPED``."""
    return FOLDER / f"{name}.safetensors"


def model_file(reference: str) -> Path:
    """The shipped network's file if ``reference`` names one, else the file of that name."""
    return shipped_model(reference) if reference in SHIPPED else Path(reference)
