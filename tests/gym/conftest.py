"""Fixtures of the tests that train."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def log_of_training(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Give Stable-Baselines3 a folder for its log; otherwise it leaves one in the temporary folder."""
    monkeypatch.setenv("SB3_LOGDIR", str(tmp_path_factory.mktemp("log")))
