"""The example of a hand predictor, its calibration, its page and the template: each does what it says."""

from __future__ import annotations

import importlib.util
import json
import math
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from safety_harness.admission.admit import admit
from safety_harness.admission.trial import judge, run_kinematic
from safety_harness.base.exceptions import ControllerError
from safety_harness.cli.console import AS_EXPECTED
from safety_harness.cli.new import new
from safety_harness.cli.validate import validate
from safety_harness.extensions.lab.learning.metrics import conformal_quantile
from safety_harness.scenario.model import Scenario
from safety_harness.scenario.read import read_scenario
from safety_harness.space.read import read_space
from safety_harness.trace.trace import Trace

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/how-to/predictor.md").read_text()
BLOCKS = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, ROOT / "examples" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def block(beginning: str) -> str:
    (text,) = (text for text in BLOCKS if text.startswith(beginning))
    return text


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    """The page's scenario, in a folder with the example."""
    folder = tmp_path_factory.mktemp("page")
    (folder / "examples").mkdir()
    shutil.copy(ROOT / "examples/constant_acceleration.py", folder / "examples")
    (folder / "mine.yaml").write_text(block("scenario:"))
    return read_scenario(folder / "mine.yaml")


@pytest.fixture(scope="module")
def trace(made: Scenario) -> Trace:
    return run_kinematic(admit(made))


def test_the_worked_example_gives_the_verdicts_and_numbers_of_its_page(made: Scenario, trace: Trace) -> None:
    evaluations = judge(trace)
    for claim, evaluation in zip(made.claims, evaluations, strict=True):
        assert evaluation.verdict is claim.expected, evaluation
    share = re.search(r"hold the hand at ([\d.]+%) of all instants", evaluations[0].reason)
    assert share is not None
    assert share[1].replace("%", " %") in PAGE
    off = re.search(r"off by ([\d.]+) mm", evaluations[1].reason)
    assert off is not None
    assert f"error is {float(off[1]):.0f} mm" in PAGE
    assert f"{(evaluations[1].worst_time_s - 0.5) * 1e3:.0f} ms after the hand started" in PAGE


def test_the_boxes_of_the_kalman_filter_are_as_large_as_the_page_says(made: Scenario) -> None:
    trace = run_kinematic(admit(replace(made, predictor="kalman filter")))
    squares_m2 = np.diagonal(trace.predicted["shape_m2"], axis1=2, axis2=3)[trace.ticks["track_valid"]]
    words = " x ".join(f"{width_m * 1e3:.0f}" for width_m in np.sqrt(np.median(squares_m2, axis=0)))
    assert f"median half widths are {words} mm" in PAGE


def test_every_set_of_the_example_is_a_ball_of_its_radius(trace: Trace) -> None:
    radius_m = example("constant_acceleration").RADIUS_M
    assert f"a radius of {radius_m * 1e3:.0f} mm" in PAGE
    balls = trace.predicted["shape_m2"][trace.ticks["track_valid"]]
    assert len(balls) > 600
    assert np.allclose(balls, radius_m**2 * np.eye(3))
    assert not trace.predicted["box"].any()


def test_the_example_is_deterministic(made: Scenario, trace: Trace) -> None:
    again = run_kinematic(admit(made))
    assert again.ticks.tobytes() == trace.ticks.tobytes()
    for name in ("shape_m2", "box"):
        assert np.array_equal(again.predicted[name], trace.predicted[name])


def test_the_example_refuses_a_horizon_for_which_it_is_not_calibrated(made: Scenario) -> None:
    settings = made.settings
    hand_filter = replace(settings.hand_filter, prediction_horizon_s=0.2)
    longer = replace(made, settings=replace(settings, hand_filter=hand_filter))
    with pytest.raises(ControllerError, match=re.escape("calibrated for 0.1 s ahead, not 0.2 s")):
        run_kinematic(admit(longer))


def test_the_example_follows_an_accelerated_hand_exactly_and_keeps_two_hands_apart() -> None:
    module = example("constant_acceleration")
    times_s = 0.1 + 0.03 * np.arange(7)

    def place_m(time_s: float, side: float) -> np.ndarray:
        return np.array([1.0 + 0.5 * time_s, side * (0.4 - 2.0 * time_s**2), 0.1])

    predictor = module.ConstantAcceleration()
    predictor.tracks, predictor.count = {}, 0
    for k, time_s in enumerate(times_s):  # the order within a frame changes
        predictor.measure(time_s, [place_m(time_s, side) for side in ((1.0, -1.0), (-1.0, 1.0))[k % 2]])
    assert sorted(predictor.tracks) == [1, 2]
    for number, side in ((1, 1.0), (2, -1.0)):
        found_m = module.followed(predictor.tracks[number], 0.45)
        assert np.allclose(found_m, place_m(0.45, side), atol=1e-9)


def test_the_calibration_takes_one_error_a_run_and_its_quantile() -> None:
    module = example("calibrate_predictor")
    errors_m = module.errors_m(2, module.SEED)
    assert errors_m.shape == (2,)
    assert (errors_m > 0.0).all()
    assert (errors_m < 0.5).all()
    assert f"draws {module.RUNS} runs" in PAGE
    assert f"the seed {module.SEED}" in PAGE


@pytest.mark.parametrize("count", [19, 20, 39, 199])
def test_the_quantile_has_the_rank_of_the_page(count: int) -> None:
    errors = np.random.default_rng(count).random(count)
    assert example("calibrate_predictor").quantile(errors, 0.95) == conformal_quantile(errors, 0.95)


def test_too_few_errors_give_no_radius() -> None:
    assert example("calibrate_predictor").quantile(np.ones(18), 0.95) == math.inf


@pytest.mark.parametrize(("count", "level", "calibration"), [(20, 0.95, 19), (41, 0.95, 30), (2, 0.5, 1)])
def test_nobody_is_in_both_the_calibration_and_the_test(count: int, level: float, calibration: int) -> None:
    split = example("calibrate_predictor").split
    names = [f"person {k}" for k in range(count)]
    first, second = split(names, level, 1)
    assert (len(first), len(second)) == (calibration, count - calibration)
    assert sorted([*first, *second]) == sorted(names)
    assert split(names[::-1], level, 1) == (first, second)  # whatever the order on the command line
    assert len({tuple(split(names, level, seed)[0]) for seed in range(9)}) > 1


@pytest.mark.parametrize(
    ("count", "level", "words"),
    [
        (19, 0.95, "95 % needs 20 people, 19 for the calibration and 1 for the test; there are 19"),
        (99, 0.99, "99 % needs 100 people, 99 for the calibration and 1 for the test; there are 99"),
        (1, 0.5, "50 % needs 2 people, 1 for the calibration and 1 for the test; there are 1"),
    ],
)
def test_too_few_people_are_refused_with_the_number_that_is_needed(
    count: int, level: float, words: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        example("calibrate_predictor").split([f"person {k}" for k in range(count)], level, 1)


def test_people_are_named_by_words_or_by_their_folders(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("anna/a.csv", "anna/b.csv", "ben/c.csv")]
    for file in files:
        file.parent.mkdir(exist_ok=True)
        file.touch()
    (tmp_path / "empty").mkdir()
    people_of = example("calibrate_predictor").people_of
    people = {"anna": files[:2], "ben": files[2:]}
    assert people_of([f"anna={files[0]},{files[1]}", f"ben={files[2]}"]) == people
    with pytest.raises(ValueError, match="empty has no recording"):
        people_of([str(tmp_path)])
    (tmp_path / "empty").rmdir()
    assert people_of([str(tmp_path)]) == people
    with pytest.raises(ValueError, match="belongs to two people, or twice to one"):
        people_of([f"anna={files[0]}", f"ben={files[0]}"])
    with pytest.raises(ValueError, match="anna is named twice"):
        people_of([f"anna={files[0]}", f"anna={files[1]}"])
    with pytest.raises(ValueError, match="anna has no recording, or one that is no file"):
        people_of(["anna=absent.csv"])


def test_a_person_counts_once_with_the_largest_error(monkeypatch: pytest.MonkeyPatch) -> None:
    module = example("calibrate_predictor")
    monkeypatch.setattr(module, "recorded", lambda file, seed: float(file.stem))
    monkeypatch.setattr(module, "error_m", lambda error_m: error_m)
    names = [f"person {k}" for k in range(20)]
    people = {name: [Path(f"0.{k}.csv"), Path(f"{k}.csv")] for k, name in enumerate(names, 1)}
    calibration, (tested,) = module.split(names, 0.95, module.SEED)
    radius_m, test_m = module.calibrate_on(people, 0.95)
    assert radius_m == max(names.index(name) + 1 for name in calibration)
    assert test_m == [names.index(tested) + 1]


def test_a_recording_gives_one_error_at_the_instant_of_its_seed() -> None:
    module = example("calibrate_predictor")
    file = ROOT / "scenarios/recordings/collaborativehammering-2.csv"
    few_m = [module.person_error_m([file], [seed]) for seed in (1, 1, 2)]
    assert 0.0 < few_m[0] < 0.5
    assert few_m[0] == few_m[1] != few_m[2]
    assert module.person_error_m([file, file], [1, 2]) == max(few_m)


def test_the_space_of_the_page_is_the_space_of_the_calibration(tmp_path: Path) -> None:
    (tmp_path / "page.yaml").write_text(block("scenario space:"))
    (tmp_path / "calibration.yaml").write_text(example("calibrate_predictor").SPACE)
    of_page, of_calibration = (
        read_space(tmp_path / name).draw(1, 0) for name in ("page.yaml", "calibration.yaml")
    )
    assert of_page.predictor == "examples/constant_acceleration.py:ConstantAcceleration"
    assert replace(of_page, predictor="", name="") == replace(of_calibration, predictor="", name="")


def test_the_page_s_program_answers_as_its_page_says(made: Scenario) -> None:
    """A program that gives the page's own line at each tick."""
    (line,) = re.findall(r"```json\n(.*?)\n```", PAGE)
    program = f"""
import json, sys
for text in sys.stdin:
    said = json.loads(text)
    answer = {{"say": "ready"}}
    if said["say"] == "hello":
        answer = {{"say": "hello", "protocol": said["protocol"], "name": "still", "sees": ["joints"]}}
    if said["say"] == "act":
        answer = json.loads({line!r}) | {{"tick": said["tick"]}}
    print(json.dumps(answer), flush=True)
"""
    assert made.file is not None
    file = made.file.parent / "still.py"
    file.write_text(program)
    trace = run_kinematic(admit(replace(made, predictor=f"exec:{sys.executable} {file}")))
    (hand,) = json.loads(line)["hands"]
    assert (trace.ticks["predicted_hand_in_base_m"][:, 0] == hand["position_in_base_m"]).all()
    assert np.allclose(trace.predicted["shape_m2"][:, 0], hand["radius_m"] ** 2 * np.eye(3))


def test_the_plan_of_the_page_is_valid(made: Scenario) -> None:
    assert made.file is not None
    folder = made.file.parent
    (folder / "reaching.yaml").write_text(block("scenario space:"))
    (folder / "plan.yaml").write_text(block("plan:"))
    assert validate([folder / "plan.yaml"]) == AS_EXPECTED


def test_the_template_runs_with_every_claim_as_expected(tmp_path: Path) -> None:
    new("predictor", tmp_path / "my cell.yaml")
    assert (tmp_path / "my_cell_predictor.py").is_file()
    scenario = read_scenario(tmp_path / "my cell.yaml")
    evaluations = judge(run_kinematic(admit(scenario)))
    for claim, evaluation in zip(scenario.claims, evaluations, strict=True):
        assert evaluation.verdict is claim.expected, evaluation
        assert evaluation.exercised, evaluation
