"""What is written may be shown to anybody: no path of the machine that made it, nor who works there."""

from __future__ import annotations

import getpass
import sqlite3
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, DIFFERS
from safety_harness.cli.fuzz import fuzz
from safety_harness.cli.scenario_commands import replay, run
from safety_harness.extensions.assurance.campaign.ledger import Ledger
from safety_harness.extensions.assurance.campaign.session import plan_of
from safety_harness.extensions.assurance.certification import whose_fault
from safety_harness.extensions.assurance.commands.certify import certify
from safety_harness.extensions.attribution import search_attribution
from safety_harness.scenario.files import display_path
from safety_harness.scenario.references import portable
from safety_harness.search import session as search_session
from safety_harness.trace.store import load_trace, save_trace
from tests.whole.test_execution import OWN, SCENARIO, SMALL_PLAN, SPACE

MINE = """\
from safety_harness import Proposal


class Mine:
    name = "mine"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        raise ValueError("never")
"""


@pytest.fixture(autouse=True)
def _few_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    """One of each kind that is written."""
    monkeypatch.setattr(search_session, "SHRINKING_RUNS", 2)
    monkeypatch.setattr(search_session, "MOST_SHRUNK", 1)
    monkeypatch.setattr(search_attribution, "MOST_ATTRIBUTED", 1)
    monkeypatch.setattr(whose_fault, "MOST", 1)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A user's folder."""
    folder = tmp_path_factory.mktemp("somebodys-home") / "project"
    (folder / "avoiders").mkdir(parents=True)
    (folder / "avoiders" / "mine.py").write_text(MINE)
    for name, text in (("scenario", SCENARIO), ("space", SPACE), ("plan", SMALL_PLAN)):
        (folder / name).mkdir()
        own = text.replace(OWN, f"../avoiders/{OWN}").replace("space.yaml", "../space/space.yaml")
        (folder / name / f"{name}.yaml").write_text(own)
    return folder


def contents(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Everything in a folder, unpacked; a file of SQLite as what its tables say."""
    for path in folder.rglob("*"):
        if not path.is_file():
            continue
        yield path.name, path.read_bytes()
        if path.suffix == ".trace":
            yield from members(path.name, path)
        if path.suffix == ".sqlite":
            connection = sqlite3.connect(path)
            for (table,) in list(connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")):
                for row in connection.execute(f"SELECT * FROM {table}"):
                    yield f"{path.name}: {table}", b"\n".join(_bytes(value) for value in row)
            connection.close()


def members(name: str, file: Path) -> Iterator[tuple[str, bytes]]:
    with zipfile.ZipFile(file) as archive:
        for member in archive.namelist():
            yield f"{name}: {member}", archive.read(member)


def _bytes(value: object) -> bytes:
    if not isinstance(value, bytes):
        return f"{value}".encode()
    try:
        return value + zlib.decompress(value)
    except zlib.error:
        return value


def refuse_paths(folder: Path, project: Path) -> None:
    forbidden = {f"{project}", f"{project.parent}", f"{Path.home()}/", f"{Path(__file__).parents[2]}/"}
    user = getpass.getuser()
    forbidden |= {f"/{user}/"}
    found = list(contents(folder))
    assert found
    for name, data in found:
        for text in forbidden | {project.parent.name}:
            assert text.encode() not in data, f"{name} has {text}"


@pytest.mark.parametrize("absolute", [False, True], ids=["relative", "absolute"])
def test_what_run_fuzz_and_certify_write_names_no_folder_of_this_machine(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, absolute: bool
) -> None:
    monkeypatch.chdir(project)
    base = project if absolute else Path()
    out = base / f"out-{absolute}"
    assert run([base / "scenario" / "scenario.yaml"], out / "run") in (AS_EXPECTED, DIFFERS)
    assert fuzz(base / "space" / "space.yaml", out=out / "fuzz", budget=2) in (AS_EXPECTED, DIFFERS)
    assert certify(base / "plan" / "plan.yaml", out=out / "report", workers=1) in (AS_EXPECTED, DIFFERS)
    refuse_paths(out, project)
    trace = out / "run" / "traces" / "scenario.trace"
    assert load_trace(trace).scenario.file == Path("scenario/scenario.yaml")
    assert replay(trace, f"avoiders/{OWN}") == AS_EXPECTED
    with Ledger.open(out / "report" / "ledger.sqlite") as ledger, plan_of(ledger) as plan:
        assert plan.file.resolve() == project / "plan" / "plan.yaml"


def test_from_elsewhere_too(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = f"{project}/avoiders/{OWN}"
    assert run([project / "scenario" / "scenario.yaml"], Path("run"), own) in (AS_EXPECTED, DIFFERS)
    refuse_paths(Path("run"), project)
    trace = Path("run/traces/scenario.trace")
    assert load_trace(trace).scenario.file == Path("scenario.yaml")
    assert replay(trace, own) == AS_EXPECTED
    assert replay(trace) == BAD_INPUT


def test_a_trace_with_a_path_of_an_earlier_version_is_read_as_it_is(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(project)
    assert run([Path("scenario/scenario.yaml")], tmp_path / "run") in (AS_EXPECTED, DIFFERS)
    now = load_trace(tmp_path / "run" / "traces" / "scenario.trace")
    old = replace(now, scenario=replace(now.scenario, file=project / "scenario" / "scenario.yaml"))
    monkeypatch.setattr("safety_harness.trace.store.display_path", lambda path: path)
    save_trace(old, tmp_path / "old.trace")
    assert load_trace(tmp_path / "old.trace").scenario.file == project / "scenario" / "scenario.yaml"


def test_a_file_is_told_as_the_working_directory_sees_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = tmp_path / "a" / "b"
    here.mkdir(parents=True)
    monkeypatch.chdir(here)
    assert display_path(here / "x" / "y.yaml") == Path("x/y.yaml")
    assert display_path(Path("x/y.yaml")) == Path("x/y.yaml")
    assert display_path(tmp_path / "y.yaml") == Path("y.yaml")
    assert display_path(Path("../y.yaml")) == Path("../y.yaml")
    assert display_path(Path("../" * 40 + "etc/y.yaml")) == Path("y.yaml")
    assert portable("../m.py", here) == "../m.py"
    assert portable(f"{here}/x/m.py", here) == "x/m.py"
    assert portable(f"{tmp_path}/m.py", here) == "m.py"
    assert portable("../" * 40 + "etc/m.py", here) == "m.py"
