"""Whatever is given the wrong kind of file says what the file is, and names the command that takes it."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.base.exceptions import InstallationError
from safety_harness.cell.simulation.worlds import OpensWorld, WorldEntry
from safety_harness.cli.console import BAD_INPUT
from safety_harness.cli.main import app
from safety_harness.cli.run import run
from safety_harness.scenario.kinds import FileKind, kind_of
from tests.kinds_of_files import SCENARIO
from tests.whole.one_of_each_kind import WORDS, make_all

# What to type for each file, as a message has it; none for what no command takes.
RIGHT = {
    "base.yaml": "safety-harness run base.yaml",
    "space.yaml": "safety-harness fuzz space.yaml",
    "suite.yaml": "safety-harness run suite.yaml",
    "plan.yaml": "safety-harness certify plan.yaml",
    "run.trace": "safety-harness replay run.trace",
    "ledger.sqlite": "safety-harness campaign status ledger.sqlite",
    "evidence.html": "open it there",
    "report/evidence.html": "safety-harness verify report",
    "figures.json": "",
    "model.safetensors": "safety-harness evaluate model.safetensors",
    "model.onnx": "safety-harness evaluate model.onnx",
    "model.pt": "torch.onnx.export",
    "mine.py": "mine.py:Mine",
    "hand.csv": "safety-harness explain recording",
    "times.json": "safety-harness explain decision time",
    "noise.bin": "",
    "empty.yaml": "",
    "report": "safety-harness verify report",
}
BINARY = {"run.trace", "ledger.sqlite", "model.safetensors"}
SCENARIOS = {"base.yaml", "suite.yaml"}
# Each command with FILE in the place of the file, and the files that it takes.
COMMANDS: dict[str, set[str]] = {
    "validate FILE": {*SCENARIOS, "space.yaml", "plan.yaml"},
    "run FILE --out out": SCENARIOS,
    "show FILE --out out": {*SCENARIOS, "space.yaml"},
    "fmt --check FILE": {*SCENARIOS, "space.yaml", "plan.yaml", "report"},
    "attribute FILE": {*SCENARIOS, "run.trace"},
    "sample FILE --out out": {"space.yaml"},
    "fuzz FILE --out out": {"space.yaml"},
    "evaluate optimum --space FILE --out out": {"space.yaml"},
    "certify FILE --out out": {"plan.yaml"},
    "certify declare FILE": {"plan.yaml"},
    "certify seal FILE": {"report"},
    "verify FILE": {"report"},
    "campaign run FILE --ledger out/l": {"plan.yaml"},
    "campaign status FILE": {"ledger.sqlite"},
    "campaign query FILE": {"ledger.sqlite"},
    "campaign export FILE out.csv": {"ledger.sqlite"},
    "campaign compare FILE FILE": {"ledger.sqlite"},
    "campaign merge out/l FILE": {"ledger.sqlite"},
    "replay FILE": {"run.trace"},
    "judge FILE": {"run.trace"},
    "metrics FILE": {"model.safetensors"},
    "export FILE --out out.onnx": {"model.safetensors"},
    "validate base.yaml --avoider FILE": {"model.safetensors", "model.onnx"},
    "fuzz space.yaml --out out --avoider FILE": {"model.safetensors", "model.onnx"},
    "evaluate FILE --out out": {"model.safetensors", "model.onnx"},
    "time FILE": {"model.safetensors", "model.onnx"},
    "train trial-mc-dropout --data FILE --out out": set(),
    "certify plan.yaml --selftest FILE --out out": {"figures.json", "times.json", "empty.yaml"},
    "certify plan.yaml --declared FILE --out out": {"figures.json", "times.json", "empty.yaml"},
}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kinds")
    make_all(folder)
    (folder / "report" / "evidence.html").write_text((folder / "evidence.html").read_text())
    return folder


def refusal(words: list[str]) -> str:
    """What a command says that ends with bad input."""
    found = CliRunner().invoke(app, words)
    assert found.exception is None or isinstance(found.exception, SystemExit), repr(found.exception)
    assert found.exit_code == BAD_INPUT, found.output
    return found.output


def test_every_file_of_the_tests_is_told_by_its_content(files: Path) -> None:
    for name, words in WORDS.items():
        kind = kind_of(files / name)
        assert kind is None if words == "a text" else kind is not None and words in kind.words, name


# A command may take a kind, or what may be one of those, damaged.
WRONG = [
    (name, command)
    for name in RIGHT
    for command, taken in COMMANDS.items()
    if not (name in taken or (name == "noise.bin" and taken and taken <= BINARY))
]


@pytest.mark.parametrize(("name", "command"), WRONG)
def test_a_wrong_kind_of_file_is_named_with_the_command_for_it(
    name: str, command: str, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    said = refusal([name if word == "FILE" else word for word in command.split()])
    kind = kind_of(Path(name))
    assert kind is not None
    assert kind.words in said
    assert RIGHT[name] in said
    assert sum(not line.startswith(" ") for line in said.splitlines()) <= 2, "one mistake, and its sum"


@pytest.mark.parametrize("command", ["replay", "fuzz", "certify", "metrics", "campaign status"])
def test_a_folder_where_a_file_is_wanted_is_told_with_a_file_that_is_in_it(
    command: str, files: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    said = refusal([*command.split(), "."])
    wanted = {"replay": "run.trace", "fuzz": "space.yaml", "certify": "plan.yaml"}
    wanted |= {"metrics": "model.safetensors", "campaign status": "ledger.sqlite"}
    assert "a folder" in said
    assert f"name a file in it, such as {wanted[command]}" in said


def test_a_file_that_extends_a_space_is_taken_for_what_it_is(tmp_path: Path, files: Path) -> None:
    (tmp_path / "more.yaml").write_text(f"extends: {files / 'space.yaml'}\nseed: 3\n")
    assert kind_of(tmp_path / "more.yaml") is None
    said = refusal(["run", str(tmp_path / "more.yaml"), "--out", str(tmp_path / "out")])
    assert "a scenario space" in said
    assert "safety-harness fuzz" in said


@pytest.mark.parametrize("name", ["gone.yaml", "notes.txt"])
def test_of_what_is_not_there_or_nobodys_no_kind_is_told(name: str, files: Path) -> None:
    assert kind_of(files / name) is None


def test_a_scenario_in_another_encoding_is_not_called_binary(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_bytes(SCENARIO.encode("utf-16"))
    assert "text in UTF-8" in refusal(["validate", str(tmp_path / "mine.yaml")])


def test_a_damaged_trace_is_said_to_be_damaged(tmp_path: Path, files: Path) -> None:
    (tmp_path / "half.trace").write_bytes((files / "run.trace").read_bytes()[:500])
    assert kind_of(tmp_path / "half.trace") is FileKind.BINARY
    assert "a trace file, whole" in refusal(["judge", str(tmp_path / "half.trace")])


def test_the_kind_of_a_file_is_told_before_a_world_that_is_not_installed(
    files: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def missing() -> OpensWorld:
        raise ModuleNotFoundError(name="gone")

    gone = WorldEntry(name="gone", label="Gone", load=missing)
    assert run([files / "plan.yaml"], tmp_path / "out", world=gone) == BAD_INPUT
    assert "safety-harness certify" in capsys.readouterr().err
    with pytest.raises(InstallationError, match="the world Gone"):
        run([files / "base.yaml"], tmp_path / "out", world=gone)
