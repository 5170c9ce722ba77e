"""A name may lead to a file that is not for everybody: whatever reads it, nothing of it comes into a log."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from safety_harness.cli.fmt import format_files
from safety_harness.cli.scenario_commands import judge as judge_again
from safety_harness.cli.scenario_commands import sample
from safety_harness.cli.validate import validate
from safety_harness.extensions.assurance.campaign.plan import read_plan
from safety_harness.extensions.assurance.certification.evidence import read_evidence
from safety_harness.extensions.assurance.certification.tools import read_oracles, read_selftest
from safety_harness.extensions.assurance.commands.certify import verify
from tests.search.short_space import TEXT

SECRET = "hunter2"
SECRETS = {
    "accounts": f"root:{SECRET}:19000:0:99999:7:::\nbin:*:19000:0\n",
    "a token": SECRET,
    "variables": f"PATH=/bin\0TOKEN={SECRET}\0",
    "a key": f"-----BEGIN {SECRET}-----\n{SECRET}\n",
    "YAML": f"token: {SECRET}\n{SECRET}: 1\n{SECRET}: 2\n",
    "broken YAML": f"token: [{SECRET}, *{SECRET}\n",
    "an alias": f"a: *{SECRET}\n",
    "a tag": f"a: !{SECRET} b\n",
    "a list": f"- {SECRET}\n",
    "JSON": f'{{"token": "{SECRET}", "{SECRET}": 1}}',
    "a JSON list": f'["{SECRET}"]',
    "a JSON text": f'"{SECRET}"',
    "a table": f"{SECRET},{SECRET},b\n{SECRET},2,3\n",
    "quoted": f'"{SECRET}\n',
    "not UTF-8": f"{SECRET}\xff",
    "Python": f"{SECRET} = \n",
}
SCENARIO = TEXT.replace("scenario space", "scenario").replace("from -40 mm to 40 mm", "0 mm")
SCENARIO = SCENARIO.replace("from 700 mm to 900 mm", "700 mm").replace("from 0.2 m/s to 2 m/s", "1 m/s")
RECORDED = """\
scenario: recorded
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
avoider: opposite pose
hands:
  - hand: right hand
    recording: SECRET
    track: right_hand
    starts at: [700 mm, -500 mm, 400 mm]
    elbow towards: [1000 mm, -1200 mm, 500 mm]
claims:
  joint speeds within limits: holds
"""


def by_text(text: str) -> Callable[[Path, Path], int]:
    """A file of ours that names the secret."""

    def reads(folder: Path, secret: Path) -> int:
        (folder / "mine.yaml").write_text(text.replace("SECRET", str(secret)))
        return validate([folder / "mine.yaml"])

    return reads


def linked(name: str, read: Callable[[Path], object]) -> Callable[[Path, Path], int]:
    """A link to the secret, by a name that is read."""

    def reads(folder: Path, secret: Path) -> int:
        (folder / name).symlink_to(secret)
        found = read(folder / name)
        return found if isinstance(found, int) else 0

    return reads


def by_python(folder: Path, secret: Path) -> int:
    (folder / "mine.py").symlink_to(secret)
    return by_text(SCENARIO.replace("opposite pose", "mine.py:Mine"))(folder, secret)


def by_model(suffix: str) -> Callable[[Path, Path], int]:
    def reads(folder: Path, secret: Path) -> int:
        (folder / f"mine{suffix}").symlink_to(secret)
        return by_text(SCENARIO.replace("opposite pose", f"mine{suffix}"))(folder, secret)

    return reads


WAYS: dict[str, Callable[[Path, Path], int]] = {
    "a scenario": linked("a.yaml", lambda file: validate([file])),
    "a space": linked("a.yaml", lambda file: sample(file, out=file.parent / "out")),
    "fmt": linked("a.yaml", lambda file: format_files([file], check=False)),
    "a plan": linked("a.yaml", read_plan),
    "a trace": linked("a.trace", lambda file: judge_again([file])),
    "evidence": linked("evidence.json", read_evidence),
    "a manifest": linked(
        "manifest.json", lambda file: verify(file.parent, runs=0, seed=0, execute_programs=False)
    ),
    "a ledger": linked("a.sqlite", lambda file: _status(file)),
    "selftest": linked("a.json", read_selftest),
    "oracles": linked("a.json", read_oracles),
    "extends": by_text("scenario: mine\nextends: SECRET\n"),
    "a suite": by_text("suite: mine\nscenarios: [SECRET]\n"),
    "a recording": by_text(RECORDED),
    "a Python file": by_python,
    "a model": by_model(".safetensors"),
    "a function": by_model(".onnx"),
}


def _status(file: Path) -> int:
    from safety_harness.extensions.assurance.commands.campaign import status

    return status(file)


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_nothing_of_a_file_that_is_not_ours_is_shown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], way: Callable[[Path, Path], int]
) -> None:
    from safety_harness.base.exceptions import InputError

    for number, (kind, text) in enumerate(SECRETS.items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        secret = tmp_path / f"system-{number}"
        secret.write_bytes(text.encode("latin-1"))
        try:
            code = way(folder, secret)
        except InputError as error:
            said, code = f"{error} {error.place} {error.expected} {error.got} {error.hint}", 2
        else:
            captured = capsys.readouterr()
            said = captured.out + captured.err
        assert code == 2, kind
        assert said, kind
        assert SECRET not in said, (kind, said)
        assert secret.read_bytes() == text.encode("latin-1")


def test_a_broken_file_of_ours_is_quoted_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "a.yaml"
    file.write_text("{scenario: x, duration: 3 parsec, claims: {}}\n")
    assert validate([file]) == 2
    assert "parsec" in capsys.readouterr().err
    file.write_text("scenario: x\nhands: *right\n")
    assert validate([file]) == 2
    assert "right" in capsys.readouterr().err


def test_a_plan_brings_no_file_into_its_ledger_that_it_does_not_use(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(SECRET)
    (tmp_path / "short.yaml").write_text(TEXT.replace("hand: right hand", "hand: secret"))
    from tests.assurance.campaign.plans import PLAN

    (tmp_path / "plan.yaml").write_text(PLAN)
    names = [file.name for file in read_plan(tmp_path / "plan.yaml").files]
    assert names == ["plan.yaml", "short.yaml"]
