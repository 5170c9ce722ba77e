from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT, INTERRUPTED
from safety_harness.extensions.lab.commands.learning import dataset
from safety_harness.extensions.lab.learning import dataset as module
from safety_harness.extensions.lab.learning.manifest import data_hash, load_dataset


def test_a_data_set_is_written_and_summed_up(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "a" / "data"
    assert dataset(out, space="unseen tcp", tcps=60, candidates=10, hands=3, seed=4) == AS_EXPECTED
    made = load_dataset(out)
    assert (made.space.name, made.tcps, made.candidates, made.hands, made.seed) == (
        "unseen tcp",
        60,
        10,
        3,
        4,
    )
    printed = capsys.readouterr()
    assert "180 = 60 TCPs x 3 hands" in printed.out
    assert f"{made.views_without_object:,}" in printed.out
    assert data_hash(made) in printed.out
    assert "60 TCPs" in printed.err  # progress is no result


@pytest.mark.parametrize(
    ("options", "said"),
    [({"space": "unsen"}, "'unseen hand'"), ({"tcps": 0}, "tcps"), ({"seed": -1}, "seed")],
)
def test_bad_options_are_explained_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], options: dict[str, object], said: str
) -> None:
    assert dataset(tmp_path / "data", **options) == BAD_INPUT
    assert said in capsys.readouterr().err
    assert not (tmp_path / "data").exists()


def test_a_place_that_cannot_be_written_is_explained(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert dataset(tmp_path / "file", tcps=5, candidates=2, hands=2) == BAD_INPUT
    assert "can be written" in capsys.readouterr().err


def test_an_interrupted_data_set_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "generate", interrupted)
    assert dataset(tmp_path / "data", tcps=5) == INTERRUPTED
    assert "interrupted" in capsys.readouterr().err
    assert not (tmp_path / "data").exists()
