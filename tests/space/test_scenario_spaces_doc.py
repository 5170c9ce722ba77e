"""docs/how-to/scenarios.md: every example is read or run, and what it says of numbers and names is so."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import hypothesis
import pytest
from hypothesis import Phase, settings
from spaces import FILES, ROOT

from safety_harness.base.exceptions import ScenarioError
from safety_harness.space.distributions import LEAST_MASS
from safety_harness.space.read import parse_space
from safety_harness.space.reading import MOST_COLUMNS
from safety_harness.space.regions import REGIONS, UNSEEN_HAND_FACTOR, UNSEEN_TCP_FACTOR
from safety_harness.space.sentences import MOST_OPTIONS, MOST_TIMES

TEXT = (ROOT / "docs/how-to/scenarios.md").read_text()
PROMISE = re.compile(r"^print.*  # (10 .*) \.\.\.$", re.M)
BASE = {
    "scenario space": "scenario space: an example",
    "duration": "duration: 1 s",
    "tcp start": "tcp start: {offset: [0 mm, 0 mm, 0 mm]}",
    "claims": "claims: {gain switch reached: holds}",
}


# Without the last phase, which explains what was found already and takes most of the time.
SEARCH = settings(max_examples=2000, database=None, phases=[Phase.generate, Phase.shrink])


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def completed(example: str) -> str:
    return example + "".join(
        f"{line}\n" for key, line in BASE.items() if not re.search(f"^{key}:", example, re.M)
    )


@pytest.mark.parametrize("example", blocks("yaml"))
def test_every_example_is_a_space(example: str) -> None:
    space = parse_space(completed(example), ROOT / "scenarios/example.yaml")
    assert all(scenario in space for scenario in space.draws(1, 3))


@pytest.mark.parametrize("example", blocks("python"))
def test_every_python_example_runs_and_prints_what_it_says(
    example: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(hypothesis, "find", partial(hypothesis.find, settings=SEARCH))
    exec(compile(example, "scenario-spaces.md", "exec"), {})
    printed = capsys.readouterr().out
    for promised in PROMISE.findall(example):
        assert promised in printed


def test_one_example_promises_what_it_prints() -> None:
    assert [len(PROMISE.findall(example)) for example in blocks("python")] == [1, 0, 0]


def test_there_are_examples_and_the_first_is_complete() -> None:
    assert (len(blocks("yaml")), len(blocks("python"))) == (3, 3)
    assert completed(blocks("yaml")[0]) == blocks("yaml")[0]


def test_the_refused_example_is_refused_in_the_words_of_the_page() -> None:
    (example,), (message,) = blocks("yaml refused"), blocks("text")
    with pytest.raises(ScenarioError) as caught:
        parse_space(completed(example), Path("example.yaml"))
    assert str(caught.value) == message.strip()


def test_the_sentences_of_the_table_are_understood() -> None:
    table = TEXT.split("## In place of a value", 1)[1].split("\n\n", 2)[1]
    sentences = re.findall(r"^\| `(.*?)` \|", table, re.M)
    assert [sentence.split()[0] for sentence in sentences] == ["from", "normal", "one", "the"]
    for sentence in sentences[:2]:
        text = "hands: [{hand: h, starts at: [1 m, 1 m, 1 m], elbow towards: [2 m, 1 m, 1 m], moves: "
        assert parse_space(completed(text + f"[withdraw: {sentence}]}}]\n")).dimension == 1


def test_the_page_has_the_numbers_of_the_program() -> None:
    assert f"one of 2 to {MOST_OPTIONS} values" in TEXT
    assert f"(at most {MOST_TIMES})" in TEXT
    assert f"more than {MOST_COLUMNS} coordinates" in TEXT
    assert (LEAST_MASS, UNSEEN_HAND_FACTOR, UNSEEN_TCP_FACTOR) == (1e-6, 1.5, 2.0)
    assert "a millionth" in TEXT
    assert "out to 1.5 times its size for hands, above the table, and twice its size for TCPs" in " ".join(
        TEXT.split()
    )
    assert all(f"`{region}`" in TEXT for region in REGIONS)
    assert f"{['no', 'one', 'two', 'three', 'four', 'five', 'Six'][len(FILES)]} spaces are in" in TEXT
