from __future__ import annotations

import os
from pathlib import Path

import pytest
from scenario_strategies import RECORDING
from scenario_texts import FILE, SHA256, SHORTEST, VALID, changed, line_of, parse

from safety_harness.base.exceptions import Place, RecordingError, ScenarioError
from safety_harness.scenario.compose import MAX_BYTES
from safety_harness.scenario.read import parse_scenario, read_scenario


def test_a_file_is_read_and_named_after_it(tmp_path: Path) -> None:
    file = tmp_path / "quiet.v2.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + SHORTEST.replace("\n", "\r\n").encode())
    scenario = read_scenario(file)
    assert (scenario.name, scenario.file) == ("quiet.v2", file)
    assert scenario == parse_scenario(SHORTEST, file)


def test_a_recording_is_sought_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "walks").mkdir()
    (tmp_path / "walks/walk.csv").write_bytes(RECORDING)
    file = tmp_path / "reach.yaml"
    file.write_text(changed(f"    sha256: {SHA256}\n", ""))
    assert read_scenario(file) == parse(VALID)


def test_a_changed_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "walks").mkdir()
    (tmp_path / "walks/walk.csv").write_bytes(RECORDING + b"2.01" + b",1" * 9 + b"\n")
    file = tmp_path / "reach.yaml"
    file.write_text(VALID)
    with pytest.raises(RecordingError, match="expected a recording with this SHA-256") as caught:
        read_scenario(file)
    assert caught.value.place == Place(file=file, line=line_of(VALID, "sha256"), field="hands[1].sha256")


def test_carried_bytes_under_a_wrong_sha256_are_refused() -> None:
    with pytest.raises(RecordingError, match="SHA-256"):
        parse_scenario(VALID, FILE, {SHA256: RECORDING.replace(b"0.3", b"0.4")})


def test_a_missing_recording_is_refused_where_it_is_named() -> None:
    with pytest.raises(RecordingError, match=r"no such file: folder/walks/walk\.csv") as caught:
        parse_scenario(VALID, FILE)
    assert caught.value.place == Place(FILE, line_of(VALID, "recording:"), "hands[1].recording")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no such file"):
        read_scenario(tmp_path / "none.yaml")


def test_a_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="a folder"):
        read_scenario(tmp_path)


def test_a_pipe_is_refused_rather_than_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(ScenarioError, match="not a regular file"):
        read_scenario(tmp_path / "pipe.yaml")


def test_a_name_that_is_too_long_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="a file with a name of printable characters, at most 150 bytes"):
        read_scenario(tmp_path / ("x" * 5000))


def test_a_large_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "large.yaml"
    file.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(ScenarioError, match="at most 1,000,000 bytes"):
        read_scenario(file)


def test_text_in_another_encoding_is_refused_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "latin.yaml"
    file.write_bytes("scenario: x\nabout: grün\n".encode("latin-1"))
    with pytest.raises(ScenarioError, match="expected text in UTF-8; got the byte 0xfc") as caught:
        read_scenario(file)
    assert caught.value.place == Place(file=file, line=2)
