"""Define the messages between the harness and the process of a user's avoider."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from safety_harness.cell.avoidance.asking import Answer, Question
from safety_harness.cell.avoidance.avoider import LARGEST, Vector
from safety_harness.scenario.decision_times import LONGEST_S
from safety_harness.seams.isolation.messages import Drop, Failed, Make, ProcessMessage, Refused, decoder_of
from safety_harness.seams.rows import PackedSeen, packed_seen, unpacked

# A choice: a longer frame from the process is refused before it can fill the memory.
MOST_ANSWER_BYTES = 131_072
MOST_ANSWER_WORDS = 960  # bytes; a trace keeps 240 characters


class Ask(ProcessMessage, tag="ask"):
    """A message with packed questions to the avoider ``number``.

    If ``together`` is True and the avoider can answer many questions in one call, the process uses one call.
    """

    number: int
    questions: list[tuple[Vector, Vector, int, float, PackedSeen | None]]
    together: bool

    @classmethod
    def from_questions(cls, number: int, questions: list[Question], together: bool) -> Ask:
        """Return a message with ``questions``, in which the views are packed."""
        packed = [(*q[:4], None if q.seen is None else packed_seen(q.seen)) for q in questions]
        return cls(number, packed, together)

    @property
    def unpacked_questions(self) -> list[Question]:
        """The questions of the message, with unpacked views."""
        return [Question(*q[:4], None if q[4] is None else unpacked(q[4])) for q in self.questions]


class Made(ProcessMessage, tag="made"):
    """The properties of an avoider."""

    name: str
    spread_threshold_m: Annotated[float, Meta(ge=0.0, le=LARGEST)] | None
    decision_time_s: Annotated[float, Meta(ge=0.0, le=LONGEST_S)]
    takes_many: bool
    sees: tuple[str, ...]


class Answered(ProcessMessage, tag="answered"):
    """The answer to the question ``number`` of a message, before any check."""

    number: int
    answer: Answer


to_the_child = decoder_of(Make | Ask | Drop)
from_the_child = decoder_of(Made | Refused | Answered | Failed)
