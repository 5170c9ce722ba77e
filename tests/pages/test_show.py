"""``show`` draws what a file would try; ``sample`` gives files that run takes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from safety_harness import admit, read_scenario, read_space
from safety_harness.admission.preview import preview_of
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.scenario_commands import sample
from safety_harness.extensions.pages.commands.drawing import show
from safety_harness.extensions.pages.commands.show_files import regions_of

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def test_a_scenario_and_a_space_are_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [SCENARIOS / "second-hand.yaml", SCENARIOS / "spaces" / "unseen-both.yaml"]
    assert show(files, out=tmp_path, draws=5) == AS_EXPECTED
    out, err = capsys.readouterr()
    assert out.splitlines() == [str(tmp_path / "second-hand.svg"), str(tmp_path / "unseen-both.svg")]
    scenario, space = (Path(line).read_text() for line in out.splitlines())
    assert "right hand" in scenario  # in the key
    assert "5 draws." in space
    assert "5 of " in err


@pytest.mark.parametrize("name", ["x.png", "x.pdf"])
def test_a_picture_of_another_kind_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert show([SCENARIOS / "second-hand.yaml"], out=tmp_path / name) == BAD_INPUT
    assert "a folder, or a file.svg" in capsys.readouterr().err
    assert not (tmp_path / name).exists()


def test_one_file_may_be_drawn_under_a_name_of_its_own(tmp_path: Path) -> None:
    assert show([SCENARIOS / "second-hand.yaml"], out=tmp_path / "my.svg") == AS_EXPECTED
    assert "<svg" in (tmp_path / "my.svg").read_text()


def test_a_file_that_cannot_be_read_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert show([tmp_path / "none.yaml"], out=tmp_path) == BAD_INPUT
    assert str(tmp_path / "none.yaml") in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_an_error_and_no_traceback(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert show([SCENARIOS / "second-hand.yaml"], out=tmp_path / "file" / "x.svg") == BAD_INPUT


def test_the_preview_begins_where_the_scenario_does() -> None:
    scenario = read_scenario(SCENARIOS / "second-hand.yaml")
    preview = preview_of(admit(scenario))
    desired = np.array(scenario.settings.cell.desired_tcp_position_in_base_m)
    np.testing.assert_allclose(preview.tcp_in_base_m, desired + scenario.start.offset_in_base_m, atol=1e-9)
    for hand, path in zip(scenario.hands, preview.hand_paths_in_base_m, strict=True):
        np.testing.assert_array_equal(path[0], hand.starts_at_in_base_m)
    # The desired image is that of an object under the camera: in its middle.
    assert abs(preview.desired_image_px.mean(axis=0) - [320, 240]).max() < 2.0


def test_the_regions_in_the_picture_are_those_of_table_3() -> None:
    regions = {
        name: (low, high)
        for name, low, high in regions_of(read_space(SCENARIOS / "spaces" / "unseen-tcp.yaml"))
    }
    low, high = regions["unseen tcp"]
    np.testing.assert_allclose((low + high) / 2.0, (0.7, 0.0, 0.35), atol=1e-12)
    np.testing.assert_allclose(high - low, (0.24, 0.6, 0.4), atol=1e-12)


@pytest.mark.parametrize("name", ["unseen-both", "recorded-variations"])
def test_samples_are_files_that_can_be_run_and_are_of_the_space(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = SCENARIOS / "spaces" / f"{name}.yaml"
    assert sample(file, out=tmp_path / "deep" / "er", count=3, seed=5) == AS_EXPECTED
    out, err = capsys.readouterr()
    assert "3 of " in err
    for line in out.splitlines():
        admit(read_scenario(Path(line)))
    assert sample(file, out=tmp_path / "other" / "place", count=3, seed=5) == AS_EXPECTED
    for line in out.splitlines():
        twin = tmp_path / "other" / "place" / Path(line).name
        assert twin.read_text() == Path(line).read_text()


def test_a_count_that_makes_no_sense_is_refused(tmp_path: Path) -> None:
    assert sample(SCENARIOS / "spaces" / "nominal.yaml", out=tmp_path, count=0) == BAD_INPUT


def test_each_scenario_of_a_matrix_has_its_picture(tmp_path: Path) -> None:
    assert show([SCENARIOS / "every-avoider.yaml"], out=tmp_path) == AS_EXPECTED
    assert len(list(tmp_path.glob("every-avoider*.svg"))) == 9
