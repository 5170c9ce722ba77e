"""A certificate is confirmed by code that shares none, and one that claims something false is not."""

from __future__ import annotations

import ast
import base64
import json
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from safety_harness.base.exceptions import InputError
from safety_harness.base.settings import DEFAULTS
from safety_harness.cell.avoidance.candidates import CandidateCap
from safety_harness.cell.avoidance.shipped import shipped_model
from safety_harness.extensions.lab.proof import check
from safety_harness.extensions.lab.proof.certificate import taken_up, write_certificate
from safety_harness.extensions.lab.proof.plan import read_proof_plan
from safety_harness.extensions.lab.proof.session import Effort, continue_proofs, fresh
from tests.lab.proof.regions import plan_file

CHECKER = Path(check.__file__)
MODEL = shipped_model("student").read_bytes()
TEXT = """\
proof: a little of each
avoider: student
regions:
  corner:
    hand: {from: [600 mm, -500 mm, -200 mm], to: [700 mm, -400 mm, -100 mm]}
    tcp: {from: [650 mm, -140 mm, 260 mm], to: [700 mm, -90 mm, 300 mm]}
  middle:
    hand: {from: [640 mm, -350 mm, 200 mm], to: [740 mm, -250 mm, 300 mm]}
    tcp: {from: [660 mm, -100 mm, 340 mm], to: [740 mm, -20 mm, 420 mm]}
    apart: [100 mm, 260 mm]
  above:
    hand: {from: [640 mm, -150 mm, 240 mm], to: [700 mm, -100 mm, 290 mm]}
    tcp: {from: [690 mm, -80 mm, 360 mm], to: [740 mm, -40 mm, 410 mm]}
    apart: [100 mm, 170 mm]
claims:
  - claim: steps at most 150 mm
    in: corner
  - claim: steps at least 105 mm
    in: middle
  - claim: within 4 mm of the optimum
    in: corner
  - claim: leads away
    in: above
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("certificate")
    plan = read_proof_plan(plan_file(folder, TEXT))
    proofs = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=13)))
    write_certificate(folder / "certificate.json", plan, proofs)
    return folder


@pytest.fixture(scope="module")
def document(made: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((made / "certificate.json").read_text())
    return found


def confirmed(document: dict[str, Any]) -> list[str]:
    return check.check(json.dumps(document).encode(), MODEL)


def codes_of(claim: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(zlib.decompress(base64.b64decode(claim["tree"])), np.uint8).copy()


def with_codes(claim: dict[str, Any], codes: np.ndarray) -> None:
    claim["tree"] = base64.b64encode(zlib.compress(codes.tobytes())).decode()


def test_what_is_written_is_confirmed(document: dict[str, Any]) -> None:
    assert [line.split(":")[0] for line in confirmed(document)] == ["proven", "refuted", "refuted", "refuted"]
    shares = [claim["shares"] for claim in document["claims"]]
    assert shares[0]["proven"] == 1.0
    assert all(one["proven"] > 0.1 for one in shares)
    assert shares[3]["refuted"] > 0.005
    assert shares[1]["outside"] > 0.1


def test_the_checker_shares_no_code_and_is_short() -> None:
    text = CHECKER.read_text()
    modules = {
        name.split(".")[0]
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in (
            [node.module or ""] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names]
        )
    }
    assert modules - sys.stdlib_module_names == {"numpy", "onnx"}
    assert not {"importlib", "runpy"} & modules
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 200


def test_its_own_numbers_are_those_of_the_settings() -> None:
    cap = CandidateCap.from_settings(DEFAULTS)
    assert check.DESIRED.tolist() == list(DEFAULTS.cell.desired_tcp_position_in_base_m)
    assert check.NOMINAL.tolist() == list(DEFAULTS.avoidance.nominal_hand_position_in_base_m)
    assert (cap.radius_m, cap.cone_rad) == (check.RADIUS, check.CONE)
    assert DEFAULTS.avoidance.hand_pull == check.PULL


def wrongly_proven(document: dict[str, Any], rng: np.random.Generator) -> None:
    """A leaf that is refuted or undecided becomes proven, and the shares with it."""
    claim = document["claims"][int(rng.integers(1, 4))]
    codes = codes_of(claim)
    levels, start, count = [], 0, 1
    while count:
        levels.append(codes[start : start + count])
        start, count = start + count, 2 * int((levels[-1] < check.PROVEN).sum())
    open_leaves = [
        (k, i) for k, level in enumerate(levels) for i in np.flatnonzero((level == 7) | (level == 8))
    ]
    k, i = open_leaves[int(rng.integers(len(open_leaves)))]
    claim["shares"][check.NAMES[int(levels[k][i])]] -= 2.0**-k
    claim["shares"]["proven"] += 2.0**-k
    levels[k][i] = check.PROVEN
    with_codes(claim, codes)


def narrower_limit(document: dict[str, Any], rng: np.random.Generator) -> None:
    claim = document["claims"][int(rng.integers(3))]
    claim["limit_m"] *= 0.5 if claim["kind"] != "at least" else 1.5


def larger_region(document: dict[str, Any], rng: np.random.Generator) -> None:
    region = document["claims"][int(rng.integers(4))]["region"]
    region["tcp_low_m"][int(rng.integers(3))] -= 0.3 + rng.random()


def other_verdict(document: dict[str, Any], rng: np.random.Generator) -> None:
    claim = document["claims"][int(rng.integers(1, 4))]
    claim["verdict"] = ["proven", "undecided"][int(rng.integers(2))]


def better_shares(document: dict[str, Any], rng: np.random.Generator) -> None:
    shares = document["claims"][int(rng.integers(1, 4))]["shares"]
    part = float(rng.random()) * shares["undecided"]
    shares["proven"], shares["undecided"] = shares["proven"] + part, shares["undecided"] - part


def right_question(document: dict[str, Any], rng: np.random.Generator) -> None:
    """A question that is answered as claimed, in place of the one that is not."""
    document["claims"][3]["question"] = {
        "hand_in_base_m": [0.84, -0.35, 0.18 + 0.05 * rng.random()],
        "tcp_in_base_m": [0.70, -0.05, 0.30],
    }


def cut_tree(document: dict[str, Any], rng: np.random.Generator) -> None:
    claim = document["claims"][int(rng.integers(4))]
    codes = codes_of(claim)
    with_codes(claim, codes[: int(rng.integers(len(codes)))] if len(codes) > 1 else codes[:0])


def other_network(document: dict[str, Any], rng: np.random.Generator) -> None:
    document["model_sha256"] = rng.bytes(32).hex()


ALTERATIONS: list[Callable[[dict[str, Any], np.random.Generator], None]] = [
    wrongly_proven,
    narrower_limit,
    larger_region,
    other_verdict,
    better_shares,
    right_question,
    cut_tree,
    other_network,
]


def refuses_all(document: dict[str, Any], count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(count):
        altered = deepcopy(document)
        alter = ALTERATIONS[int(rng.integers(len(ALTERATIONS)))]
        alter(altered, rng)
        pairs = zip(altered["claims"], document["claims"], strict=True)
        changed = [one for one, was in pairs if one != was]  # the others are confirmed, which takes long
        altered["claims"] = changed or altered["claims"]
        with pytest.raises((ValueError, TypeError, zlib.error)):
            confirmed(altered)


def test_altered_certificates_are_refused(document: dict[str, Any]) -> None:
    refuses_all(document, 24, seed=0)


@pytest.mark.long
def test_a_thousand_altered_certificates_are_refused(document: dict[str, Any]) -> None:
    refuses_all(document, 1_000, seed=1)


def test_that_of_an_ensemble_is_confirmed_with_its_spread(tmp_path: Path) -> None:
    text = TEXT.replace("avoider: student", "avoider: student-ensemble")
    text = text.replace("within 4 mm of the optimum", "uncertain or within 4 mm of the optimum")
    plan = read_proof_plan(plan_file(tmp_path, text))
    proofs = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=9)))
    write_certificate(tmp_path / "certificate.json", plan, proofs)
    model, data = shipped_model("student-ensemble").read_bytes(), (tmp_path / "certificate.json").read_bytes()
    lines = check.check(data, model)
    assert "unsure 0.004 m" in lines[2]
    found = json.loads(data)
    assert found["claims"][2]["shares"]["proven"] > 0.1
    found["claims"][2]["limit_m"] = 0.0001
    found["claims"][2]["question"] = None
    with pytest.raises(ValueError, match="a box is not proven"):
        check.check(json.dumps(found).encode(), model)


def test_it_is_taken_up_where_it_ended(made: Path) -> None:
    plan = read_proof_plan(made / "proofs.yaml")
    before = taken_up(made / "certificate.json", plan)
    after = list(continue_proofs(plan, before, Effort(seconds=1e6, halvings=15)))
    straight = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=15)))
    for one, other in zip(after, straight, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one.tree.levels, other.tree.levels, strict=True))


def test_nor_is_more_time_than_there_is_taken(made: Path) -> None:
    plan, start_s = read_proof_plan(made / "proofs.yaml"), time.monotonic()
    proofs = list(continue_proofs(plan, fresh(plan), Effort(seconds=0.4, halvings=60)))
    assert time.monotonic() - start_s < 10.0
    assert any(proof.tree.shares()["undecided"] for proof in proofs)


def test_what_processes_take_to_start_is_no_time_of_a_claim(
    made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = [0.0]
    starts_s = iter([100.0])

    def over(judge: Callable[[Any], Any], boxes: Iterable[Any]) -> Iterator[Any]:
        clock[0] += next(starts_s, 0.0)
        return map(judge, boxes)

    plan = read_proof_plan(made / "proofs.yaml")
    whole = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=9)))
    monkeypatch.setattr(time, "monotonic", lambda: clock[0])
    slow = list(continue_proofs(plan, fresh(plan), Effort(seconds=10.0, halvings=9, over=over)))
    for one, other in zip(slow, whole, strict=True):
        assert all(np.array_equal(a, b) for a, b in zip(one.tree.levels, other.tree.levels, strict=True))


def test_a_certificate_of_another_plan_is_not_gone_on_with(made: Path, tmp_path: Path) -> None:
    plan = read_proof_plan(plan_file(tmp_path, TEXT.replace("150 mm", "151 mm")))
    with pytest.raises(InputError, match="of this plan"):
        taken_up(made / "certificate.json", plan)


@pytest.mark.parametrize("tree", ["", "AAAA", "!", 7])
def test_nor_one_whose_tree_is_none(
    made: Path, document: dict[str, Any], tmp_path: Path, tree: object
) -> None:
    broken = deepcopy(document)
    broken["claims"][1]["tree"] = tree
    (tmp_path / "broken.json").write_text(json.dumps(broken))
    with pytest.raises(InputError, match="a tree of codes"):
        taken_up(tmp_path / "broken.json", read_proof_plan(made / "proofs.yaml"))


NO_PAIR = """\
proof: no question at all
avoider: student
regions:
  nowhere:
    hand: {from: [600 mm, -500 mm, -200 mm], to: [700 mm, -400 mm, -100 mm]}
    tcp: {from: [650 mm, -140 mm, 260 mm], to: [700 mm, -90 mm, 300 mm]}
    apart: [10 mm, 100 mm]
claims:
  - claim: steps at most 150 mm
    in: nowhere
"""


def test_a_region_without_a_pair_proves_nothing(tmp_path: Path) -> None:
    """Its boxes may well be proven; a certificate that calls the claim proven is refused."""
    plan = read_proof_plan(plan_file(tmp_path, NO_PAIR))
    proofs = list(continue_proofs(plan, fresh(plan), Effort(seconds=1e6, halvings=9)))
    assert [proof.verdict for proof in proofs] == ["no pair"]
    written = write_certificate(tmp_path / "certificate.json", plan, proofs)
    (line,) = check.check(json.dumps(written).encode(), MODEL)
    assert line.startswith("no pair: ")
    written["claims"][0]["verdict"] = "proven"
    with pytest.raises(ValueError, match="it is no pair"):
        check.check(json.dumps(written).encode(), MODEL)
