"""One file of every kind that somebody may give to a command, and what names the kind."""

from __future__ import annotations

import json
import pickle
import zipfile
from pathlib import Path

from safety_harness.admission.admit import admit
from safety_harness.admission.avoiders import shipped_avoider
from safety_harness.admission.trial import run_kinematic
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.scenario.read import read_scenario
from safety_harness.trace.store import save_trace
from tests.assurance.campaign.plans import ledger_in, plan_in
from tests.kinds_of_files import SCENARIO

PYTHON = "class Mine:\n    name = 'mine'\n\n    def propose(self, **question):\n        return None\n"
_PAGE = "<!DOCTYPE html>\n<html><head><title>{}</title></head></html>\n"
# The words by which a message calls each, by the name of the file.
WORDS = {
    "base.yaml": "a scenario",
    "space.yaml": "a scenario space",
    "suite.yaml": "a suite",
    "plan.yaml": "a plan",
    "run.trace": "a trace",
    "ledger.sqlite": "the ledger of a campaign",
    "evidence.html": "a page",
    "report.html": "a page",
    "figures.json": "the figures of",
    "model.safetensors": "a model",
    "model.onnx": "a model in ONNX",
    "model.pt": "a model of PyTorch",
    "mine.py": "a Python file",
    "hand.csv": "a table",
    "times.json": "measured decision times",
    "noise.bin": "a binary file",
    "empty.yaml": "an empty file",
    "notes.txt": "a text",
    "folder": "a folder",
    "report": "the folder of an evidence report",
}


def make_all(folder: Path) -> dict[str, Path]:
    """A file or folder of every kind, by its name."""
    plan = plan_in(folder)
    (folder / "short.yaml").rename(folder / "space.yaml")
    (folder / "plan.yaml").write_text((folder / "plan.yaml").read_text().replace("short.yaml", "space.yaml"))
    (folder / "base.yaml").write_text(SCENARIO)
    (folder / "suite.yaml").write_text("suite: all\nscenarios: [base.yaml]\n")
    admitted = admit(read_scenario(folder / "base.yaml"), avoider=shipped_avoider("opposite pose"))
    save_trace(run_kinematic(admitted), folder / "run.trace")
    ledger_in(folder, plan).close()
    (folder / "evidence.html").write_text(_PAGE.format("Evidence: plan"))
    (folder / "report.html").write_text(_PAGE.format("Safety verification"))
    (folder / "figures.json").write_text(json.dumps({"format": "safety-harness report 1", "runs": []}))
    (folder / "times.json").write_text(json.dumps({"format": "safety-harness decision times 1"}))
    (folder / "model.safetensors").write_bytes(shipped_model("deterministic").read_bytes())
    (folder / "model.onnx").write_bytes(b"\x08\x0a\x12\x07pytorch" + bytes(64))
    with zipfile.ZipFile(folder / "model.pt", "w") as archive:
        archive.writestr("model/data.pkl", pickle.dumps({}))
    (folder / "mine.py").write_text(PYTHON)
    (folder / "hand.csv").write_text("time_s,hand_x_m\n0.0,1.0\n")
    (folder / "noise.bin").write_bytes(bytes(range(256)) * 4)
    (folder / "empty.yaml").write_text("")
    (folder / "notes.txt").write_text("remember the milk\n")
    (folder / "folder").mkdir()
    (folder / "report").mkdir()
    (folder / "report" / "manifest.json").write_text(
        json.dumps({"format": "safety-harness manifest 1", "sha256": {}})
    )
    return {name: folder / name for name in WORDS}
