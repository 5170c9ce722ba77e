"""The key ``shield`` of a scenario file: a name or a mapping, read back as written, refused in its place."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from safety_harness.admission.admit import check
from safety_harness.base.exceptions import InadmissibleError, ScenarioError
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.main import app
from safety_harness.cli.validate import validate
from safety_harness.scenario.read import parse_scenario
from safety_harness.scenario.shield import Shield
from safety_harness.scenario.write import write_scenario

TEXT = """
scenario: nobody is there
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims:
  joint speeds within limits: holds
"""
POSTURE = (
    "settings: {cell: {preferred joint position: [-14 deg, -82 deg, 116 deg, -124 deg, -90 deg, -104 deg]}}\n"
)


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("", None),
        ("shield: speed and separation\n", Shield()),
        ("shield: {hand speed: 1.6 m/s}\n", Shield(hand_speed_mps=1.6)),
        (
            "shield: {hand acceleration: 10 m/s2, reaction time: 450 ms}\n",
            Shield(hand_acceleration_mps2=10.0, reaction_time_s=0.45),
        ),
    ],
)
def test_it_is_read_and_written(written: str, meant: Shield | None) -> None:
    found = parse_scenario(TEXT + written)
    assert found.shield == meant
    assert parse_scenario(write_scenario(found)).shield == meant
    assert ("shield" in write_scenario(found)) == (meant is not None)


@pytest.mark.parametrize(
    ("written", "said"),
    [
        ("shield: speed\n", r":7: shield: expected speed and separation; got speed"),
        ("shield: {hand sped: 1 m/s}\n", r':7: shield.hand sped: .* \(did you mean "hand speed"\?\)'),
        ("shield: {deceleration: 0 m/s2}\n", r":7: shield.deceleration: expected an acceleration"),
    ],
)
def test_what_is_none_is_refused(written: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        parse_scenario(TEXT + written)


@pytest.mark.parametrize("kind", ["eye in hand", "overhead"])
def test_a_shield_does_not_rest_on_a_sensor_that_sees_a_part_of_the_cell(kind: str) -> None:
    blind = parse_scenario(TEXT + f"shield: speed and separation\nhand sensor: {{kind: {kind}}}\n")
    with pytest.raises(
        InadmissibleError, match=r":7: shield: expected a hand sensor that sees the whole cell"
    ):
        check(blind)


@pytest.mark.parametrize(
    ("drives", "too_short", "enough"),
    [
        ("lag: 2 ms", "0 ms", "22 ms"),
        ("lag: 20 ms", "0 ms", "148 ms"),
        ("dead time: 100 ms", "90 ms", "100 ms"),
        ("torque limit: 100 %", "0 ms", "8 ms"),
    ],
)
def test_drives_later_than_its_reaction_time_are_refused(drives: str, too_short: str, enough: str) -> None:
    """Such a scenario contradicts assumption 7 on its face."""
    text = TEXT + f"robot: {{arm: 'shipped:ur10e', drives: {{{drives}}}}}\n" + POSTURE
    with pytest.raises(InadmissibleError, match=r"expected a reaction time of at least"):
        check(parse_scenario(text + f"shield: {{reaction time: {too_short}}}\n"))
    check(parse_scenario(text + f"shield: {{reaction time: {enough}}}\n"))


LATE = (  # the reaction time that each needs is checked above
    "lag: 2 ms",
    *(
        pytest.param(one, marks=pytest.mark.long)
        for one in ("torque limit: 100 %", "dead time: 8 ms", "lag: 20 ms")
    ),
)


def files_in(folder: Path, drives: str, shield: str) -> dict[str, Path]:
    """The drives in a file that extends the one with the shield: as a scenario, a suite and a space."""
    robot = f"robot: {{arm: 'shipped:ur10e', drives: {{{drives}}}}}\n"
    start = TEXT.replace("offset: [0 mm,", "offset: [from 0 mm to 5 mm,").replace(
        "scenario:", "scenario space:"
    )
    texts = {
        "shield": f"{TEXT}{POSTURE}{shield}",
        "extends": f"extends: shield.yaml\n{robot}",
        "matrix": f"extends: shield.yaml\nmatrix:\n  robot: {{late: {{{robot.strip()}}}}}\n",
        "space": f"{start}{POSTURE}{shield}{robot}",
    }
    for name, text in texts.items():
        (folder / f"{name}.yaml").write_text(text)
    return {name: folder / f"{name}.yaml" for name in texts if name != "shield"}


@pytest.mark.parametrize("drives", LATE)
def test_validate_and_run_refuse_such_drives_wherever_they_come_from(
    drives: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for form, file in files_in(tmp_path, drives, "shield: speed and separation\n").items():
        assert validate([file]) == BAD_INPUT, form
        assert "expected a reaction time of at least" in capsys.readouterr().err, form
    done = CliRunner().invoke(app, ["run", str(tmp_path / "extends.yaml"), "--out", str(tmp_path / "out")])
    assert done.exit_code == BAD_INPUT
    assert "expected a reaction time of at least" in done.output
    for form, file in files_in(tmp_path, drives, "shield: {reaction time: 150 ms}\n").items():
        assert validate([file]) == AS_EXPECTED, form
