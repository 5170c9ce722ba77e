"""Files that extend and name each other at random: reading them ends, with scenarios or with reasons."""

from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from safety_harness.scenario.expand import gather

BASE = """\
scenario: a base
duration: 1 s
tcp start: {offset: [0 mm, 0 mm, 0 mm]}
claims: {gain switch reached: holds}
"""


@st.composite
def tangles(draw: st.DrawFn) -> list[str]:
    """Files that extend each other, name each other and multiply, at random."""
    count = draw(st.integers(1, 5))
    texts = []
    for _ in range(count):
        other = st.integers(0, count).map(lambda number: f"f{number}.yaml")  # one more than there are
        kind = draw(st.sampled_from(["plain", "extends", "extends", "matrix", "suite"]))
        if kind == "suite":
            names = draw(st.lists(other | st.just("."), min_size=1, max_size=4))
            texts.append(f"suite: s\nscenarios: [{', '.join(names)}]\n")
            continue
        text = f"extends: {draw(other)}\n" if kind == "extends" else BASE
        if kind == "matrix" or draw(st.booleans()):
            axes = draw(st.lists(st.integers(1, 40), min_size=1, max_size=12))
            labels = [
                ", ".join(
                    f"n{n}: {{{draw(st.sampled_from(['seed', 'about', 'x']))}: {n}}}" for n in range(axis)
                )
                for axis in axes[: draw(st.integers(1, 3))]
            ]
            text += "matrix:\n" + "".join(f"  a{at}: {{{one}}}\n" for at, one in enumerate(labels))
        texts.append(text)
    return texts


@hypothesis_settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(tangles())
def test_a_tangle_of_files_ends(tmp_path_factory: pytest.TempPathFactory, texts: list[str]) -> None:
    folder = tmp_path_factory.mktemp("tangle")
    for number, text in enumerate(texts):
        (folder / f"f{number}.yaml").write_text(text)
    gathered = gather([folder])
    assert gathered.errors or gathered.scenarios
    assert len(gathered.scenarios) <= 1_000 * len(texts)
    for error in gathered.errors:
        assert error.expected
        assert error.got
        assert error.place.file is not None
