"""Avoiders that see more than one hand and the TCP: what they are shown, when, and in which process."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from examples import VISIT, hand, scenario

from safety_harness.admission.admit import admit
from safety_harness.admission.repeatability import Repeatability
from safety_harness.admission.trial import run_kinematic, run_many
from safety_harness.base.exceptions import InadmissibleError, Place
from safety_harness.cell.avoidance.asking import Question, ask, takes_many
from safety_harness.cell.avoidance.avoider import Proposal
from safety_harness.cell.avoidance.isolation.isolated import isolated_avoider
from safety_harness.scenario.moves import MoveTo, Wait
from safety_harness.seams.contract import Seen, UnseenError
from safety_harness.trace.trace import Trace

OTHER = hand(
    MoveTo(position_in_base_m=(0.95, 0.5, 0.3), speed_mps=0.5),
    Wait(duration_s=2.0),
    name="left",
    at=(1.1, 0.75, 0.2),
)
TWO_HANDS = scenario(VISIT, OTHER, duration_s=1.6)
EXAMPLE = Path("examples/two_hands.py").resolve()


@dataclass(eq=False)
class Watching:
    """Goes up, and notes down what it was asked and shown."""

    sees: tuple[str, ...] = ("joints", "hands", "object", "predicted hands")
    decision_time_s: float | None = None
    shown: list[tuple[np.ndarray, np.ndarray, Seen]] = field(default_factory=list)
    name = "watching"

    def propose(
        self,
        *,
        hand_position_in_base_m: np.ndarray,
        tcp_position_in_base_m: np.ndarray,
        seed: int,
        seen: Seen,
    ) -> Proposal:
        """100 mm up."""
        self.shown.append((hand_position_in_base_m, tcp_position_in_base_m, seen))
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])


@pytest.fixture(scope="module")
def watched() -> tuple[Watching, Trace]:
    avoider = Watching()
    return avoider, run_kinematic(admit(TWO_HANDS, avoider=avoider))


def test_it_sees_all_hands_their_velocities_and_covariances_and_the_joints(
    watched: tuple[Watching, Trace],
) -> None:
    avoider, trace = watched
    assert len(avoider.shown) == len(trace.decisions) > 0
    for (hand_in_base_m, tcp_in_base_m, seen), decision in zip(avoider.shown, trace.decisions, strict=True):
        assert seen.time_s == decision["time_s"]
        np.testing.assert_array_equal(seen.joint_position_rad, decision["joint_position_rad"])
        np.testing.assert_array_equal(seen.tcp_position_in_base_m, tcp_in_base_m)
        assert len(seen.predicted_hands) == len(seen.hands) == 2
        assert seen.object.features.shape == (6,)
        assert any(np.array_equal(one.position_in_base_m, hand_in_base_m) for one in seen.predicted_hands)
        for one in seen.predicted_hands:
            assert np.linalg.eigvalsh(one.covariance).min() > -1e-12
            assert not one.covariance.flags.writeable
    first = avoider.shown[0][2].predicted_hands
    assert max(np.linalg.norm(one.velocity_in_base_mps) for one in first) == pytest.approx(1.0, rel=0.2)


def test_what_it_does_not_say_that_it_sees_is_not_there(watched: tuple[Watching, Trace]) -> None:
    with pytest.raises(UnseenError, match='"hand boxes" is not among'):
        watched[0].shown[0][2].hand_boxes  # noqa: B018


def test_an_answer_that_counts_later_is_made_of_what_was_seen_when_it_was_asked() -> None:
    avoider = Watching(decision_time_s=0.04)
    trace = run_kinematic(admit(TWO_HANDS, avoider=avoider))
    asked_s = trace.ticks["time_s"][trace.decisions["asked_tick"]]
    assert [seen.time_s for *_, seen in avoider.shown] == asked_s.tolist()
    assert len(asked_s)
    assert (asked_s < trace.decisions["time_s"]).all()


def test_three_keywords_are_all_that_another_is_asked_with() -> None:
    class Three:
        name = "three"

        def propose(self, **question: Any) -> Proposal:
            """Straight up."""
            assert sorted(question) == ["hand_position_in_base_m", "seed", "tcp_position_in_base_m"]
            return Proposal(question["tcp_position_in_base_m"] + [0.0, 0.0, 0.1])

    assert not any(run_kinematic(admit(TWO_HANDS, avoider=Three())).decisions["fault"])


def test_it_answers_the_same_bits_in_a_process_of_its_own_and_in_a_batch(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(EXAMPLE.parent))
    from two_hands import AwayFromAll  # type: ignore[import-not-found]

    here = run_kinematic(admit(TWO_HANDS, avoider=AwayFromAll()))
    apart = admit(TWO_HANDS, avoider=isolated_avoider(EXAMPLE, "AwayFromAll", Place(field="avoider")))
    assert len(here.decisions)
    assert not here.decisions["fault"].any()
    for trace in (run_kinematic(apart), *run_many([apart, apart])):
        assert trace.decisions.tobytes() == here.decisions.tobytes()
        np.testing.assert_array_equal(trace.ticks["joint_position_rad"], here.ticks["joint_position_rad"])


def test_outside_of_a_run_nothing_is_seen_and_that_is_its_fault_in_words() -> None:
    answer = ask(Watching(), Question(np.zeros(3), np.zeros(3), 0))  # type: ignore[arg-type]
    assert answer.fault.startswith(
        "it sees joints, hands, object, predicted hands, which no question outside"
    )


def test_one_that_sees_more_is_asked_one_by_one() -> None:
    class Both(Watching):
        def propose_many(self, *questions: Any) -> None:
            """Never called."""

    assert not takes_many(Both())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("sees", "seen", "said"),
    [
        ('("joint",)', "seen", "sees that is a list of inputs"),
        ('("image",)', "seen", "no pixels"),
        ('"joints"', "seen", "sees must be a tuple"),
        ('("joints",)', "shown", r"to have propose\(\*, hand_position_in_base_m, .*, seed, seen\)"),
    ],
)
def test_sees_that_cannot_be_shown_are_refused(sees: str, seen: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text(
        f'class Mine:\n    name = "mine"\n    sees = {sees}\n'
        f"    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed, {seen}): ...\n"
    )
    with pytest.raises(InadmissibleError, match=said):
        isolated_avoider(file, "Mine", Place(field="avoider"))


def test_its_runs_are_driven_again_since_no_trace_keeps_what_it_saw(tmp_path: Path) -> None:
    text = EXAMPLE.read_text().replace("np.zeros(3)", "np.full(3, len(ASKED))  # and one more")
    text = text.replace("# and one more", "+ (ASKED.append(seed) or 0.0)") + "\n\nASKED = []\n"
    (tmp_path / "remembers.py").write_text(text)
    for file, said in (
        (EXAMPLE, "the same to the last bit"),
        (tmp_path / "remembers.py", "the avoider carries something over from earlier episodes: a fresh one"),
    ):
        admitted = admit(scenario(VISIT, OTHER, duration_s=1.2, avoider=f"{file}:AwayFromAll"))
        again = Repeatability()
        for _ in range(2):
            again.add(run_kinematic(admitted))
        assert said in again.check().line
