"""The system under test is its weights too: what its module opens or imports is hashed and kept to."""

from __future__ import annotations

import json
import os
import sys
import zipfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import InputError, LedgerError
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.merging import merge
from safety_harness.extensions.assurance.campaign.plan import Plan
from safety_harness.extensions.assurance.campaign.session import plan_of, processes, run_missing
from safety_harness.extensions.assurance.certification.gather import gather
from tests.assurance.campaign.plans import plan_in
from tests.search.short_space import TEXT

PLAN = """\
plan: weights
{tested}
world: kinematic
strata:
  - stratum: near
    space: short.yaml
    runs: 4
claims:
  - claim: hand distance never below 1 mm
keep:
  random traces: 4
"""
AVOIDER = """
import json, zipfile
from pathlib import Path
import numpy as np
from safety_harness import Proposal
from layers import GAIN

HERE = Path(__file__).parent
HARNESS_FILES = ["declared.bin"]
SIGN = json.loads((HERE / "weights.json").read_text())[0] * np.load(HERE / "w.npy")[0] * GAIN
with zipfile.ZipFile(HERE / "sb3.zip") as archive:
    SIGN *= float(archive.read("policy"))
(HERE / "log.txt").write_text("what is written is not read")

class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        away = tcp_position_in_base_m - hand_position_in_base_m
        scale = 0.1 * float((HERE / "late.txt").read_text())
        return Proposal(tcp_position_in_base_m + SIGN * scale * away / np.linalg.norm(away))
"""
CONTROLLER = """
from pathlib import Path
import numpy as np
from safety_harness import Move

class Mine:
    name, sees = "mine", ("joints",)

    def reset(self, *, settings, arm, start, seed):
        self.speed = float(np.load(Path(__file__).with_name("w.npy"))[0])

    def act(self, seen):
        return Move(joint_velocity_radps=np.full(6, 0.01 * self.speed))
"""
FILES = {"weights.json", "w.npy", "sb3.zip", "late.txt", "declared.bin", "layers.py"}


def write(folder: Path, name: str, value: float = 1.0) -> None:
    """One of the files, with other bytes for another value."""
    file = folder / name
    if name == "w.npy":
        np.save(file, np.array([value]))
    elif name == "sb3.zip":
        with zipfile.ZipFile(file, "w") as archive:
            archive.writestr(zipfile.ZipInfo("policy"), str(value))
    else:
        words = {"weights.json": json.dumps([value]), "layers.py": f"GAIN = {value}\n"}
        file.write_text(words.get(name, str(value)))


def plan_with(folder: Path, tested: str = "avoider: mine.py:Mine", module: str = AVOIDER) -> Plan:
    for name in FILES:
        write(folder, name)
    (folder / "mine.py").write_text(module)
    return plan_in(folder, PLAN.format(tested=tested), TEXT)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Path]:
    """A campaign of an avoider that opens files in many ways, as it was run."""
    folder = tmp_path_factory.mktemp("weights")
    sys.path.insert(0, str(folder))  # as PYTHONPATH does: "layers" lies there
    try:
        plan = plan_with(folder)
        assert run_missing(plan, folder / "ledger.sqlite", processes(1))
    finally:
        sys.path.remove(str(folder))
    return plan, folder / "ledger.sqlite"


def test_all_that_is_read_is_noted_and_nothing_else(run: tuple[Plan, Path]) -> None:
    """By json, numpy and zipfile, by an import, in an answer, by declaration; not what is written."""
    with Ledger.open(run[1]) as ledger:
        assert {name for name, sha256 in ledger.opened.items() if sha256} == FILES
        assert ledger.opened["log.txt"] == ""
        described = gather(run[0], ledger, run[1].parent, command="").evidence.system.settings
    assert {name for name, _ in described} >= {f"file {name}" for name in FILES}


@pytest.mark.parametrize("name", sorted(FILES))
def test_other_bytes_refuse_to_go_on(run: tuple[Plan, Path], name: str) -> None:
    """Also in a complete campaign: it would state one bound over two policies."""
    plan, path = run
    write(path.parent, name, -1.0)
    try:
        with pytest.raises(LedgerError, match=f"{name} changed"):
            run_missing(plan, path, processes(1))
        with Ledger.open(path) as ledger, pytest.raises(LedgerError, match=name), plan_of(ledger):
            pass
    finally:
        write(path.parent, name)


def test_nothing_was_run_is_said_first_and_recorded_questions_are_asked_again(
    run: tuple[Plan, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, path = run
    monkeypatch.syspath_prepend(str(path.parent))
    with Ledger.open(path, write=True) as ledger, ledger.transaction():
        ledger.connection.execute("UPDATE session SET began = '2026-05-12T08:00:00+00:00'")
    before, said = path.read_bytes(), list[str]()
    assert run_missing(plan, path, processes(1), say=said.append)
    assert said[0] == "no new runs: all 4 episodes are of 12 May 2026"
    assert "asked again of a second avoider" in said[1]
    assert "the same answers" in said[1]
    assert path.read_bytes() == before


def test_an_answer_that_is_another_now_takes_the_bound_away(
    run: tuple[Plan, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no file says so: here the hash that was noted is the new file's."""
    plan, path = run
    monkeypatch.syspath_prepend(str(path.parent))
    other = tmp_path / "ledger.sqlite"
    other.write_bytes(path.read_bytes())
    with Ledger.open(other, write=True) as ledger, ledger.transaction():
        ledger.connection.execute("DELETE FROM opened")
    write(path.parent, "late.txt", 2.0)
    try:
        assert run_missing(plan, other, processes(1))
    finally:
        write(path.parent, "late.txt")
    with Ledger.open(other) as ledger:
        assert "asked again alone" in ledger.dependent


def test_what_a_module_writes_itself_is_its_memory(tmp_path: Path) -> None:
    """It is asked again and found out; no run is refused for it."""
    (tmp_path / "late.txt").write_text("1")
    memory = (
        AVOIDER[: AVOIDER.index("from layers")]
        + """
HERE = Path(__file__).parent

class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        count = int((HERE / "late.txt").read_text())
        (HERE / "late.txt").write_text(str(count + 1))
        return Proposal(tcp_position_in_base_m + [-0.02, 0.07, 0.001 * count])
"""
    )
    (tmp_path / "mine.py").write_text(memory)
    plan = plan_in(tmp_path, PLAN.format(tested="avoider: mine.py:Mine"), TEXT)
    assert run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        assert ledger.opened == {"late.txt": ""}
        assert "remembers" in ledger.dependent
    assert run_missing(plan, tmp_path / "ledger.sqlite", processes(1))


def test_a_file_that_is_written_while_runs_are_made_ends_them(run: tuple[Plan, Path]) -> None:
    with Ledger.open(run[1], write=True) as ledger, pytest.raises(LedgerError, match=r"w\.npy as earlier"):
        ledger.take_opened([("w.npy", "0" * 64)])


def test_a_file_that_came_after_runs_began_makes_another_system(run: tuple[Plan, Path]) -> None:
    """Statistics of inputs that were forgotten at first: before, nothing was opened that could change."""
    copy = run[1].with_name("begun.sqlite")
    copy.write_bytes(run[1].read_bytes())
    with Ledger.open(copy, write=True) as ledger:
        ledger.connection.execute("UPDATE session SET began = ?", [datetime.now(UTC).isoformat()])
        (copy.parent / "stats.npy").write_bytes(b"1")
        ledger.begin_session((datetime.now(UTC) + timedelta(seconds=1)).isoformat(), "1", "here")
        with pytest.raises(LedgerError, match=r"stats\.npy as it was when runs began"):
            ledger.take_opened([("stats.npy", "0" * 64)])
        ledger.take_opened([(run[0].file.name, "0" * 64)])  # which was there, and is opened late
    (copy.parent / "stats.npy").unlink()


def test_before_the_first_run_any_file_may_still_come(run: tuple[Plan, Path], tmp_path: Path) -> None:
    """A first session was interrupted before it ran anything."""
    (tmp_path / "stats.npy").write_bytes(b"1")
    with Ledger.create(tmp_path / "begun.sqlite", run[0]) as ledger:
        ledger.begin_session((datetime.now(UTC) - timedelta(hours=1)).isoformat(), "1", "here")
        ledger.begin_session((datetime.now(UTC) + timedelta(seconds=1)).isoformat(), "1", "here")
        ledger.take_opened([(os.path.relpath(tmp_path / "stats.npy", run[0].file.parent), "0" * 64)])


def test_parts_that_read_other_files_do_not_become_one(run: tuple[Plan, Path], tmp_path: Path) -> None:
    _, path = run
    part = path.with_name("part.sqlite")
    part.write_bytes(path.read_bytes())
    assert merge(tmp_path / "whole.sqlite", [path, part]) == 4
    with Ledger.open(tmp_path / "whole.sqlite") as whole:
        assert set(whole.opened) == {*FILES, "log.txt"}
    with Ledger.open(part, write=True) as ledger, ledger.transaction():
        ledger.connection.execute("UPDATE opened SET sha256 = 'other' WHERE name = 'w.npy'")
    with pytest.raises(LedgerError, match=r"w\.npy as earlier"):
        merge(tmp_path / "two.sqlite", [path, part])


def test_a_declared_file_that_is_not_there_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    plan = plan_with(tmp_path, module=AVOIDER.replace("declared.bin", "nowhere.bin"))
    with pytest.raises(InputError, match="HARNESS_FILES"):
        run_missing(plan, tmp_path / "ledger.sqlite", processes(1))


def test_a_controllers_weights_are_noted_too(tmp_path: Path) -> None:
    plan = plan_with(tmp_path, "controller: mine.py:Mine", CONTROLLER)
    assert run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
    with Ledger.open(tmp_path / "ledger.sqlite") as ledger:
        assert set(ledger.opened) == {"w.npy"}
    write(tmp_path, "w.npy", 2.0)
    with pytest.raises(LedgerError, match=r"w\.npy changed"):
        run_missing(plan, tmp_path / "ledger.sqlite", processes(1))
