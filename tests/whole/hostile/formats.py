"""Every kind of file that is read, in one place: how a whole one is made, and what reads it.

Whoever adds a kind of file adds it here, and all that can be wrong with a file is tried on it.
"""

from __future__ import annotations

import hashlib
import io
import json
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import run_kinematic
from safety_harness.base.settings import DEFAULTS, ObjectKind
from safety_harness.cell.avoidance.model_file import load_model
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.campaign.rows import ClaimJudgement, Row
from safety_harness.extensions.assurance.campaign.summary import fingerprint_of, tally_of
from safety_harness.extensions.assurance.certification.counterexamples import FINDINGS, read_findings
from safety_harness.extensions.assurance.certification.evidence import as_text, read_evidence
from safety_harness.extensions.assurance.certification.folder import FORMAT as REPORT_FORMAT
from safety_harness.extensions.assurance.certification.folder import MANIFEST as MANIFEST_OF_REPORT
from safety_harness.extensions.assurance.certification.folder import read_manifest
from safety_harness.extensions.assurance.certification.tools import read_oracles, read_selftest
from safety_harness.extensions.assurance.statistics.sample import EpisodeOutcome
from safety_harness.extensions.field.recorded.compare import as_json, read_comparison
from safety_harness.extensions.lab.learning.dataset import generate, space_named
from safety_harness.extensions.lab.learning.manifest import ARRAYS, MANIFEST, load_dataset, save_dataset
from safety_harness.extensions.selftest.document import document
from safety_harness.scenario.expand import gather
from safety_harness.scenario.read import read_scenario
from safety_harness.space.read import read_space
from safety_harness.trace.store import load_trace, save_trace
from tests.assurance.campaign.plans import PLAN, ledger_in, plan_in
from tests.assurance.certification.made_up_comparison import cell
from tests.assurance.certification.made_up_evidence import evidence
from tests.search.short_space import TEXT as SHORT
from tests.selftest.made_up_faults import CAUGHT, LIMIT, SURVIVES, about
from tests.whole.hostile.readers import checkpoint_bytes, checkpoint_read, kept_read, onnx_read

ROOT = Path(__file__).parents[3]
SCENARIO = """\
scenario: a short run
duration: 320 ms
tcp start:
  offset: [0 mm, -60 mm, 20 mm]
hands:
  - hand: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
    moves:
      - move to: [840 mm, -350 mm, 250 mm]
        speed: 1 m/s
claims:
  joint speeds within limits: holds
"""
SPACE = SCENARIO.replace("scenario:", "scenario space:").replace("1 m/s", "from 0.5 m/s to 1 m/s")
RECORDED = """\
scenario: a recorded hand
duration: 320 ms
tcp start:
  offset: [0 mm, -60 mm, 20 mm]
hands:
  - hand: right hand
    recording: file.csv
    track: right hand
    starts at: [1100 mm, -750 mm, 200 mm]
    elbow towards: [1600 mm, -1200 mm, 300 mm]
claims:
  joint speeds within limits: holds
"""
CSV = "time_s,right_hand_x_m,right_hand_y_m,right_hand_z_m\n" + "".join(
    f"{k / 25:.3f},{1 + k / 100:.4f},{0.5 - k / 200:.4f},{k / 300:.4f}\n" for k in range(30)
)


@dataclass(frozen=True)
class Format:
    """A kind of file; ``read`` gives something, or raises an InputError.

    ``sealed``: what ends early is never taken; ``hashed``: no changed byte that means anything is.
    ``beside``: other files that it needs.
    """

    name: str
    file: str
    whole: Callable[[], bytes]
    read: Callable[[Path], object]
    text: bool = True
    sealed: bool = False
    hashed: bool = False
    beside: Callable[[], dict[str, bytes]] = dict

    def put(self, folder: Path, data: bytes) -> Path:
        """A file with ``data`` and what it needs beside it."""
        for name, other in self.beside().items():
            (folder / name).write_bytes(other)
        path = folder / self.file
        path.write_bytes(data)
        return path


def _gathered(path: Path) -> object:
    found = gather([path])
    for error in found.errors:
        raise error
    return found.scenarios


@lru_cache
def trace_bytes() -> bytes:
    """A short run in the kinematic world."""
    scenario = read_scenario(_file("s.yaml", SCENARIO.encode()))
    path = _file("t.trace", b"")
    save_trace(run_kinematic(admit(replace(scenario, avoider="opposite pose"))), path)
    return path.read_bytes()


def _file(name: str, data: bytes) -> Path:
    """In a folder of this process's own."""
    path = _folder() / name
    path.write_bytes(data)
    return path


@lru_cache
def _folder() -> Path:
    import atexit
    import shutil
    import tempfile

    folder = Path(tempfile.mkdtemp())
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@lru_cache
def onnx_bytes() -> bytes:
    """The file of the example."""
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        from onnx_model import straight_up
    finally:
        sys.path.pop(0)
    data: bytes = straight_up().SerializeToString()
    return data


@lru_cache
def dataset_bytes() -> dict[str, bytes]:
    """A small data set."""
    settings = replace(
        DEFAULTS,
        servo=replace(DEFAULTS.servo, object_kind=ObjectKind.DISCRETE),
        avoidance=replace(DEFAULTS.avoidance, hand_pull=0.1 / 3.0),
    )
    folder = _folder() / "data"
    save_dataset(
        generate(settings, space_named("unseen both", settings), seed=2, tcps=10, candidates=20, hands=4),
        folder,
    )
    return {name: (folder / name).read_bytes() for name in (ARRAYS, MANIFEST)}


@lru_cache
def ledger_bytes() -> bytes:
    """A ledger with a few episodes."""
    folder = _folder() / "ledger"
    with ledger_in(folder, plan_in(folder)) as ledger:
        judgements = (
            ClaimJudgement(EpisodeOutcome.HOLDS, 0.1, 0.2, 3),
            ClaimJudgement(EpisodeOutcome.UNTESTED),
        )
        ledger.record(
            Row(stratum=0, episode=k, seed=11 + k, judgements=judgements, draws=1, cell="a", trace=b"x" * 100)
            for k in range(20)
        )
        ledger.connection.execute("PRAGMA journal_mode = DELETE")
        return ledger.path.read_bytes()


def _ledger_read(path: Path) -> object:
    """Everything in it."""
    with Ledger.open(path) as ledger:
        found = [ledger.outcomes(0, claim) for claim in (0, 1)]
        return found, list(ledger.missing(0)), ledger.trace(0, 3), fingerprint_of(ledger), tally_of(ledger)


def selftest_bytes() -> bytes:
    """As the command writes it."""
    return json.dumps(document([CAUGHT, SURVIVES, LIMIT], about())).encode()


def findings_bytes() -> bytes:
    """What fuzz writes, with a point or two."""
    point = {
        "complaint": "a",
        "kind": "b",
        "runs": 1,
        "worst_margin_si": -0.1,
        "worst_point": [0.5],
        "number": 3,
    }
    found = {
        "space": "a hand nearby",
        "avoider": None,
        "searcher": "default",
        "seed": 1,
        "budget": 100,
        "tried": 100,
        "refused": {},
        "interrupted": False,
        "claims": [],
        "baseline": None,
        "distinct": [point],
        "confirmed_in": ["PyBullet"],
        "confirmed": 1,
        "not_confirmed": [point],
        "counterexamples": ["a.yaml"],
        "coverage": {},
        "violations_by_cell": {},
    }
    return json.dumps(found, indent=1).encode()


def without(name: str) -> dict[str, bytes]:
    """The other files of the data set."""
    return {other: data for other, data in dataset_bytes().items() if other != name}


def repacked(data: bytes, **changes: bytes) -> bytes:
    """A trace in which parts are replaced (``ticks_npy``), its hashes made to fit."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as before:
        parts = {name: before.read(name) for name in before.namelist()}
    parts |= {name: changes[key] for name in parts if (key := name.replace(".", "_")) in changes}
    if "trace_json" not in changes:
        header = json.loads(parts["trace.json"])
        header["sha256"] = {
            name: hashlib.sha256(part).hexdigest() for name, part in parts.items() if name != "trace.json"
        }
        parts["trace.json"] = json.dumps(header).encode()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as after:
        for name, part in parts.items():
            after.writestr(name, part)
    return out.getvalue()


def run_json(**changes: object) -> bytes:
    """The run of the trace with other fields."""
    with zipfile.ZipFile(io.BytesIO(trace_bytes())) as archive:
        return json.dumps(json.loads(archive.read("run.json")) | changes).encode()


def npy(array: np.ndarray) -> bytes:
    """As numpy writes it."""
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, array, allow_pickle=False)
    return buffer.getvalue()


FORMATS = [
    Format("scenario", "file.yaml", SCENARIO.encode, read_scenario),
    Format("space", "file.yaml", SPACE.encode, read_space),
    Format(
        "suite",
        "file.yaml",
        lambda: b"suite: all of them\nscenarios:\n  - other.yaml\n  - another.yaml\n",
        _gathered,
        beside=lambda: {f"{name}.yaml": SCENARIO.encode() for name in ("other", "another")},
    ),
    Format(
        "extending scenario",
        "file.yaml",
        lambda: b"extends: other.yaml\nduration: 240 ms\nwithout: [hands]\n",
        read_scenario,
        beside=lambda: {"other.yaml": SCENARIO.encode()},
    ),
    Format(
        "recording",
        "file.csv",
        CSV.encode,
        lambda path: read_scenario(path.with_name("recorded.yaml")),
        beside=lambda: {"recorded.yaml": RECORDED.encode()},
    ),
    Format("trace", "file.trace", trace_bytes, load_trace, text=False, sealed=True, hashed=True),
    Format(
        "model",
        "file.safetensors",
        lambda: shipped_model("deterministic").read_bytes(),
        load_model,
        text=False,
        sealed=True,
    ),
    Format("ONNX model", "file.onnx", onnx_bytes, onnx_read, text=False),
    Format(
        "data set",
        ARRAYS,
        lambda: dataset_bytes()[ARRAYS],
        lambda path: load_dataset(path.parent),
        text=False,
        sealed=True,
        hashed=True,
        beside=lambda: without(ARRAYS),
    ),
    Format(
        "manifest of a data set",
        MANIFEST,
        lambda: dataset_bytes()[MANIFEST],
        lambda path: load_dataset(path.parent),
        hashed=True,
        beside=lambda: without(MANIFEST),
    ),
    Format("checkpoint", "file.safetensors", checkpoint_bytes, checkpoint_read, text=False),
    Format("kept failure", "file.yaml", SCENARIO.encode, kept_read),
    Format("plan", "plan.yaml", PLAN.encode, read_plan, beside=lambda: {"short.yaml": SHORT.encode()}),
    Format("ledger", "ledger.sqlite", ledger_bytes, _ledger_read, text=False),
    Format("evidence", "evidence.json", lambda: as_text(evidence()).encode(), read_evidence),
    Format("trial of the harness", "selftest.json", selftest_bytes, read_selftest),
    Format("table of oracles", "oracles.json", (ROOT / "plans" / "oracles.json").read_bytes, read_oracles),
    Format(
        "worlds beside a cell",
        "compare-worlds.json",
        lambda: as_json(cell().comparison).encode(),
        read_comparison,
    ),
    Format(
        "manifest of a report",
        MANIFEST_OF_REPORT,
        lambda: json.dumps({"format": REPORT_FORMAT, "sha256": {"a.txt": "0" * 64}}).encode(),
        lambda path: read_manifest(path.parent),
    ),
    Format("findings of a search", FINDINGS, findings_bytes, read_findings),
]
