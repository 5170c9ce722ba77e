"""The hash of settings is kept, and stays where it was made."""

from __future__ import annotations

import pickle

from safety_harness.base.settings import Settings


def test_equal_settings_have_equal_hashes_and_what_is_kept_does_not_travel() -> None:
    """Hashes of text are another process's own."""
    one, other = Settings(), Settings()
    assert hash(one) == hash(other) == hash(pickle.loads(pickle.dumps(one)))
    assert vars(pickle.loads(pickle.dumps(one))).keys() == vars(Settings()).keys()
