"""The hash of a program holds the files that it declares; every verdict says that others are not known."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.cell.controller.out_of_process.references import program_sha256
from tests.cell.controller.out_of_process.programs import PROGRAM

PLACE = Place(field="controller")
DECLARED = [
    'HARNESS_FILES = ["weights.json"]',
    "HARNESS_FILES = [\n    'weights.json',  # of the policy\n]",
    '# HARNESS_FILES: weights.json "weights.json"',
]


def program_in(folder: Path, declared: str) -> str:
    (folder / "weights.json").write_text("[1.0]")
    file = folder / "still.py"
    file.write_text(f"#!{sys.executable}\n{PROGRAM}{declared}\n")
    file.chmod(0o755)
    return f"exec:{file}"


@pytest.mark.parametrize("declared", DECLARED)
def test_other_weights_make_another_program(declared: str, tmp_path: Path) -> None:
    program = program_in(tmp_path, declared)
    before = program_sha256(program, PLACE)
    (tmp_path / "weights.json").write_text("[-1.0]")
    assert program_sha256(program, PLACE) != before
    (tmp_path / "weights.json").write_text("[1.0]")
    assert program_sha256(program, PLACE) == before
    assert program_sha256(f"exec:{sys.executable} {tmp_path / 'still.py'}", PLACE) != before


def test_a_shell_script_declares_as_a_shell_does(tmp_path: Path) -> None:
    (tmp_path / "a.bin").write_bytes(b"1")
    (tmp_path / "b.bin").write_bytes(b"1")
    script = tmp_path / "run.sh"
    script.write_text('#!/bin/sh\nHARNESS_FILES="a.bin b.bin"\nexec cat $HARNESS_FILES\n')
    script.chmod(0o755)
    hashes = set()
    for name in ("", "a.bin", "b.bin"):
        (tmp_path / name).write_bytes(b"2") if name else None
        hashes.add(program_sha256(f"exec:{script}", PLACE))
    assert len(hashes) == 3


def test_a_declared_file_that_is_not_there_is_refused(tmp_path: Path) -> None:
    program = program_in(tmp_path, DECLARED[0])
    (tmp_path / "weights.json").unlink()
    with pytest.raises(InadmissibleError, match=r"HARNESS_FILES to be a list of files.*weights\.json"):
        program_sha256(program, PLACE)
