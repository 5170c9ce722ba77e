"""docs/reference/formulas.md says what the code does: its sentences, its Python and its table of signals."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from safety_harness.claims.formulas import language
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.claims.formulas.parse import parse_formula
from safety_harness.claims.formulas.signals import SIGNALS
from safety_harness.trace.trace import Trace

DOCS = Path(__file__).parents[3] / "docs"
PAGE = (DOCS / "reference" / "formulas.md").read_text()
SENTENCES = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)[0].splitlines()


@pytest.mark.parametrize("sentence", SENTENCES)
def test_every_sentence_is_a_claim_that_a_run_can_be_judged_by(sentence: str, visit: Trace) -> None:
    assert FormulaClaim(parse_formula(sentence)).evaluate(visit).reason


def test_the_python_of_the_page_is_its_third_sentence(
    visit: Trace, capsys: pytest.CaptureFixture[str]
) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    names: dict[str, object] = {"trace": visit}
    exec(compile(code, "page", "exec"), names)
    assert str(names["slows_down"]) == SENTENCES[2]
    assert capsys.readouterr().out.split()[0] in ("holds", "violated", "inconclusive")


def test_the_words_of_the_table_are_what_python_says() -> None:
    forms = {
        "always for 2 s stopped": "always(stopped(), window=s(2))",
        "always from 1 s to 2 s stopped": "always(stopped(), window=(s(1), s(2)))",
        "TCP speed < 100 mm/s": "tcp_speed() < mm_per_s(100)",
    }
    for sentence, python in forms.items():
        assert python.replace("stopped()", "a") in PAGE or python in PAGE
        assert parse_formula(sentence) == eval(python, vars(language))


def test_python_has_every_signal_by_the_name_on_the_page() -> None:
    for signal in SIGNALS:
        assert getattr(language, signal.words.lower().replace(" ", "_")) is signal
    assert set(language.__all__) <= set(vars(language))
