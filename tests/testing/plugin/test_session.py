"""A session from beginning to end: profiles, kept failures, flaky avoiders, xdist, JUnit, the report."""

from __future__ import annotations

import json
import signal
import xml.etree.ElementTree as ET
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.testing.plugin.conftest import INI

DISTANCE, SPEED = "hand distance never below 50 mm", "TCP speed never above 250 mm/s"


def kept(project: Path) -> list[Path]:
    return sorted(file for file in (project / ".safety-harness").rglob("*.yaml") if file.is_file())


def test_a_failure_is_made_smaller_kept_and_tried_first_next_time(
    run, pytester: pytest.Pytester, project: Path
) -> None:
    pytester.makeini(INI)
    first = run("test_it.py", "--safety-derandomize")
    first.assert_outcomes(passed=1, failed=1)
    first.stdout.fnmatch_lines(
        [
            ">*assert_holds(hand_distance() > mm(50), simulate(scenario))",
            "E * margin    -* mm at * s",
            "E * scenario: reaches",
            "E * pytest test_it.py::test_keeps_its_distance",
            "E * safety-harness run .safety-harness/failures/test_it.py/test_keeps_its_distance/*.yaml",
            "scenarios of failures, tried first next time:",
        ]
    )
    first.stdout.no_fnmatch_line("*Scenario(name=*Place(file=*")  # no giant repr by Hypothesis
    first.stdout.no_fnmatch_line("*hypothesis/core.py*")
    (file,) = kept(project)
    assert "hand distance > 50 mm: holds" in file.read_text().replace('"', "")
    again = run("test_it.py", "-k", "distance")
    again.assert_outcomes(failed=1, deselected=1)
    again.stdout.fnmatch_lines(["hand distance > 50 mm * 1 * 1 *", "earlier failures tried first: 1*: 0"])
    assert kept(project) == [file]
    run(str(file)).assert_outcomes(failed=1)


def test_a_space_is_a_test_of_each_claim_and_keeps_its_failures_too(run, project: Path) -> None:
    first = run("reaches.yaml", "--safety-derandomize", "-v")
    first.assert_outcomes(passed=1, failed=1)
    first.stdout.fnmatch_lines(["the scenario, made smaller:", "  scenario: reaches", f"{SPEED} * 50 *"])
    (file,) = kept(project)
    assert "hand distance never below 50 mm: holds" in file.read_text()


def test_a_kept_file_of_what_passes_now_stays_and_is_said(run, project: Path) -> None:
    run("test_it.py", "--safety-derandomize")
    (file,) = kept(project)
    test = project / "test_it.py"
    test.write_text(test.read_text().replace("> mm(50)", "< m(9)").replace("mm, ", "m, "))
    result = run("test_it.py", "-k", "distance", "--safety-derandomize")
    result.assert_outcomes(passed=1, deselected=1)
    result.stdout.fnmatch_lines(["earlier failures tried first: 1, in tests that pass now: 1", "*.yaml"])
    assert kept(project) == [file]


@pytest.mark.parametrize("of", ["reaches.yaml", "test_it.py"])
def test_a_kept_failure_is_tried_with_the_avoider_that_the_space_names_today(
    run, project: Path, of: str
) -> None:
    marker = "import pathlib; pathlib.Path(__file__).with_name('executed').touch()\n"
    (project / "old.py").write_text(
        marker + "class Silent:\n    name = 'silent'\n    def propose(self, **question): return None\n"
    )
    space = project / "reaches.yaml"
    text = space.read_text()
    space.write_text(text.replace("opposite pose", "old.py:Silent"))
    run(of, "-k", "speed or slow", "--safety-derandomize").assert_outcomes(failed=1, deselected=1)
    (file,) = kept(project)
    assert "old.py" in file.read_text()
    (project / "executed").unlink()
    space.write_text(text)
    result = run(of, "-k", "speed or slow", "--safety-derandomize")
    result.assert_outcomes(passed=1, deselected=1)
    assert not (project / "executed").exists()
    result.stdout.fnmatch_lines(["earlier failures tried first: 1, in tests that pass now: 1"])
    result.stdout.no_fnmatch_line("*with the avoider of the file*")


def test_where_the_space_varies_the_avoider_that_of_the_kept_file_is_said_to_be_used(
    run, project: Path
) -> None:
    space = project / "reaches.yaml"
    text = space.read_text()
    space.write_text(text.replace("avoider: opposite pose", "avoider:\n  one of: [opposite pose, nearest]"))
    run("reaches.yaml", "-k", "distance", "--safety-derandomize").assert_outcomes(failed=1, deselected=1)
    result = run("reaches.yaml", "-k", "distance", "--safety-derandomize")
    result.stdout.fnmatch_lines(["  with the avoider of the file in which it is kept: 1"])


def test_a_failure_of_an_object_prints_no_command_that_runs_another_avoider(
    run, pytester: pytest.Pytester, project: Path
) -> None:
    pytester.makeini(INI)
    (project / "test_it.py").write_text(
        "from safety_harness.testing import assert_holds\n"
        "from avoiders import Upwards\n"
        "def test_mine(simulate):\n"
        "    assert_holds('hand distance never below 5000 mm', simulate('fast.yaml', avoider=Upwards()))\n"
    )
    result = run("test_it.py")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*avoider upwards*", "*to see it again:", "*pytest test_it.py::test_mine"])
    result.stdout.no_fnmatch_line("*safety-harness run*")


def test_two_workers_tell_the_same_as_one(run, project: Path) -> None:
    """Of a run that a test of the one worker leaves unjudged, because one of the other judges it, too."""
    unjudged = "".join(f"def test_{k}(simulate): simulate('fast.yaml')\n" for k in range(2))
    (project / "test_unjudged.py").write_text(unjudged)  # the first two tests go to the first worker
    files = ("test_unjudged.py", "fast.yaml", "fine.yaml", "test_it.py")
    options = ("-n", "2", "--junitxml=junit.xml", "--safety-report=out/report.html", "--safety-derandomize")
    result = run(*files, *options)
    result.assert_outcomes(passed=6, failed=2)
    result.stdout.no_fnmatch_line("*that nobody judged*")
    result.stdout.fnmatch_lines([f"{SPEED} * 8 *", "report: out/report.html"])
    alone = run(*files, "--safety-derandomize")
    of_both = [[line for line in one.outlines if line.startswith("overruled ")] for one in (result, alone)]
    assert of_both[0] == of_both[1] != []
    cases = {case.get("name"): case for case in ET.parse(project / "junit.xml").iter("testcase")}
    found = {p.get("name"): p.get("value") for p in cases["test_is_slow"].iter("property")}
    assert found["claim"] == SPEED
    assert found["verdict"] == "holds"
    assert float(found["margin"] or "nan") > 0.0
    assert (found["unit"], found["avoider"], found["runs"]) == ("mm/s", "opposite pose", "6")
    assert {"worst time", "exercised", "scenario", "seed"} <= set(found)
    report = json.loads((project / "out" / "report.json").read_text())
    claims = {claim["claim"]: claim for one in report["runs"] for claim in one["claims"]}
    assert claims[DISTANCE]["verdict"] == "violated"
    coverage = {one["claim"]: one for one in report["coverage"]}
    assert coverage[SPEED]["runs"] == 8
    assert "hand distance" in (project / "out" / "report.html").read_text()


@pytest.mark.parametrize(
    ("avoider", "share"), [("avoiders.py:Doubting", "(100 %): * uncertain"), ("", "(0 %)")]
)
def test_the_end_says_how_often_the_gate_overruled(run, project: Path, avoider: str, share: str) -> None:
    fast = (project / "fast.yaml").read_text()
    (project / "reach.yaml").write_text(fast + "settings: {avoidance: {gate: reach}}\n")
    result = run(*(["fast.yaml", f"--avoider={avoider}"] if avoider else ["reach.yaml"]))
    (line,) = [line for line in result.outlines if line.startswith("overruled ")]
    assert fnmatch(line, f"overruled * of * proposal* {share}*")


def test_an_avoider_that_answers_differently_is_named_with_the_decision(run, project: Path) -> None:
    result = run("test_it.py", "-k", "slow", "--avoider", "avoiders.py:Unseeded")
    result.assert_outcomes(failed=1, deselected=1)
    result.stdout.fnmatch_lines(
        [
            "the avoider 'unseeded' answers the same question in two ways",
            "  decision  1 of *",
            "  hint *seed*",
            "  asked for at test_it.py:14",
        ]
    )


def test_another_avoider_takes_the_place_of_what_files_name(run, project: Path) -> None:
    result = run("fast.yaml", "--avoider", "avoiders.py:Upwards")
    result.stdout.fnmatch_lines(["  run *avoider upwards*", "  safety-harness run fast.yaml --avoider *"])


def test_a_violation_that_a_file_expects_of_its_own_avoider_is_marked(run, project: Path) -> None:
    """Not so of its own avoider, and not where the file says by how much."""
    fast = (project / "fast.yaml").read_text()
    own = fast.replace(f"{DISTANCE}: holds", f"{DISTANCE}: violated")
    assert own != fast
    (project / "known.yaml").write_text(own)
    (project / "bound.yaml").write_text(own.replace(": violated", ": violated by at most 900 mm"))
    words = "expected of another than --avoider: it may be for another reason: "
    files = ("known.yaml", "bound.yaml", "--junitxml=out.xml")
    result = run(*files, "--avoider", "avoiders.py:Upwards", "-k", "distance")
    assert [line for line in result.outlines if words in line] == [f"{words}known: {DISTANCE}"]
    assert (project / "out.xml").read_text().count('name="expected of another than --avoider"') == 1
    assert words not in run(*files, "-k", "distance").stdout.str()


@pytest.mark.parametrize(
    ("avoider", "said"),
    [
        ("oposite pose", 'did you mean "opposite pose"?'),
        ("avoiders.py:Sideways", "something called 'Sideways'"),
        ("broken.py:X", "ModuleNotFoundError*(broken.py:1)"),
    ],
)
def test_an_avoider_that_cannot_be_used_ends_the_session_at_once(
    run, project: Path, avoider: str, said: str
) -> None:
    (project / "broken.py").write_text("import not_there\nX = 1\n")
    result = run("fast.yaml", "--avoider", avoider)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["ERROR: --avoider", f"*{said}*"])
    result.stderr.no_fnmatch_line("*Traceback*")


def test_what_is_never_put_to_the_test_fails_test_and_session(run, project: Path) -> None:
    (project / "test_it.py").write_text(
        "from hypothesis import given, settings\n"
        "from safety_harness.testing import *\n"
        "@settings(max_examples=3)\n"
        "@given(scenario=scenarios('reaches.yaml'))\n"
        "def test_never(scenario, simulate):\n"
        "    assert_holds(whenever(object_lost()).then(stopped()), simulate(scenario))\n"
        "@settings(max_examples=3)\n"
        "@given(scenario=scenarios('reaches.yaml'))\n"
        "def test_half(scenario, simulate):\n"
        "    trace = simulate(scenario)\n"
        "    assert_holds('TCP speed never above 250 mm/s', trace)\n"
        "    assert_holds(whenever(object_lost()).then(stopped()), trace)\n"
    )
    result = run("test_it.py", "-k", "half")
    result.assert_outcomes(passed=1, deselected=1)
    assert result.ret == pytest.ExitCode.TESTS_FAILED
    result.stdout.fnmatch_lines(
        [
            "1 of * never exercised, and nothing is shown of:",
            "  whenever object lost then stopped",
            "*failed*",
        ]
    )
    never = run("test_it.py", "-k", "never")
    never.assert_outcomes(failed=1, deselected=1)
    never.stdout.fnmatch_lines(["*inconclusive in * of * judgements*"])


def test_an_assertion_that_no_draw_reaches_fails_and_plain_asserts_judge_no_run(run, project: Path) -> None:
    (project / "test_it.py").write_text(
        "from hypothesis import given, settings\n"
        "from safety_harness.testing import assert_holds, scenarios\n"
        "@settings(max_examples=3)\n"
        "@given(scenario=scenarios('reaches.yaml'))\n"
        "def test_never(scenario, simulate):\n"
        "    if len(simulate(scenario).ticks) > 1e6:\n"
        "        [assert_holds('TCP speed never above 250 mm/s', one) for one in [simulate(scenario)]]\n"
        "@settings(max_examples=3)\n"
        "@given(scenario=scenarios('reaches.yaml'))\n"
        "def test_plain(scenario, simulate):\n"
        "    assert simulate(scenario).complete\n"
    )
    result = run("test_it.py")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(
        [
            "*test_never*",
            "assert_holds was never reached in 3 draws: nothing was put to the test",
            "* simulated runs that nobody judged, in *test_it.py::test_plain; the session has failed*",
        ]
    )


TRUTHS = """\
import pytest
from safety_harness import Verdict, judge
from safety_harness.claims.formulas.claim import FormulaClaim
from safety_harness.testing import assert_holds, hand_distance, mm

RUN = "fast.yaml"

def test_truth_of_all(simulate):
    assert judge(simulate(RUN))

def test_truth_of_one(simulate):
    assert FormulaClaim(hand_distance() > mm(50)).evaluate(simulate(RUN))

def test_truth_of_verdicts(simulate):
    assert all(evaluation.verdict for evaluation in judge(simulate(RUN)))

def test_never_judged(simulate):
    simulate(RUN)

@pytest.mark.judges_runs_itself
def test_as_meant(simulate):
    assert judge(simulate(RUN))[0].verdict is Verdict.VIOLATED
"""


def test_verdicts_have_no_truth_value_and_a_run_that_nobody_judged_fails_the_session(
    run, project: Path
) -> None:
    """What is asserted of a verdict is a comparison; a test that compares by itself says so by a marker."""
    (project / "test_it.py").write_text(TRUTHS)
    result = run("test_it.py", "--strict-markers")
    result.assert_outcomes(passed=2, failed=3)
    result.stdout.fnmatch_lines(["*expected a question that a verdict answers"])
    for test, code in (("never", pytest.ExitCode.TESTS_FAILED), ("meant", pytest.ExitCode.OK)):
        result = run("test_it.py", "-k", test)
        result.assert_outcomes(passed=1, deselected=4)
        assert result.ret == code
    result = run("test_it.py", "fast.yaml", "-k", "test_never or TCP")
    assert result.ret == pytest.ExitCode.OK, "another test judged the same run"


def test_mistakes_in_a_test_are_told_in_place_of_a_traceback(run, project: Path) -> None:
    (project / "test_it.py").write_text(
        "from safety_harness import read_scenario\n"
        "from safety_harness.testing import *\n"
        "from pathlib import Path\n"
        "def test_sentence(simulate):\n"
        "    assert_holds('hand distanc > 5 mm', simulate(read_scenario(Path('fine.yaml'))))\n"
        "def test_unit(simulate):\n"
        "    assert_holds(hand_distance() > s(5), simulate(read_scenario(Path('fine.yaml'))))\n"
        "def test_violated_outside_hypothesis(simulate):\n"
        "    assert_holds(hand_distance() > mm(50), simulate(read_scenario(Path('fine.yaml'))))\n"
    )
    result = run("test_it.py")
    result.assert_outcomes(failed=3)
    result.stdout.fnmatch_lines(["test_it.py:5: assert_holds", '*did you mean "hand distance"*'])
    result.stdout.fnmatch_lines(["*expected hand distance beside a length*", "  asked for at test_it.py:7"])
    result.stdout.fnmatch_lines(["E * margin    -* mm*", "E * scenario  fine.yaml"])


def test_a_profile_that_is_none_is_a_usage_error(run, project: Path) -> None:
    assert run("fast.yaml", "--safety-profile", "slow").ret == pytest.ExitCode.USAGE_ERROR
    result = run("fast.yaml", "-o", "safety_profile=slow")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*expected one of quick, nightly, certify; got 'slow'*"])


def test_a_project_without_scenarios_is_left_alone(run, pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        "import sys\n"
        "def test_what_is_imported():\n"
        "    heavy = ('numba', 'numpy', 'pybullet', 'hypothesis', 'ruamel')\n"
        "    assert [name for name in heavy if name in sys.modules] == []\n"
        "    ours = {name for name in sys.modules if name.startswith('safety_harness.')}\n"
        "    assert not any('properties' in name or 'simulation' in name for name in ours)\n"
    )
    result = run(fresh=True)
    result.assert_outcomes(passed=1)
    result.stdout.no_fnmatch_line("*safety claims*")


def test_a_session_says_what_decisions_cost_and_that_they_took_longer_here(run, project: Path) -> None:
    avoiders = project / "avoiders.py"
    avoiders.write_text(
        avoiders.read_text().replace(
            "        return Proposal", "        __import__('time').sleep(0.02)\n        return Proposal", 1
        )
    )
    result = run("fine.yaml", "--avoider", "avoiders.py:Upwards", "-k", "speed")
    result.assert_outcomes(passed=1, deselected=1)
    result.stdout.fnmatch_lines(
        [
            "computing time: upwards: computing time not modelled",
            "computing time: upwards: on this machine * answers (100 %) took longer than the 8 ms *",
        ]
    )


def test_an_avoider_that_hangs_fails_its_test_and_has_no_verdict(run, project: Path) -> None:
    avoiders = project / "avoiders.py"
    hangs = "        while seed: pass\n        return Proposal"
    avoiders.write_text(avoiders.read_text().replace("        return Proposal", hangs, 1))
    fine = project / "fine.yaml"
    fine.write_text(fine.read_text() + "settings: {clock: {wall limit: 500 ms}}\n")
    result = run("fine.yaml", "--avoider", "avoiders.py:Upwards", "-k", "speed")
    result.assert_outcomes(failed=1, deselected=1)
    result.stdout.fnmatch_lines(["the avoider 'upwards' gave no answer within 0.5 s of wall time"])
    result.stdout.no_fnmatch_line("*holds*")


def test_what_is_compiled_in_a_captured_test_is_said_on_the_terminal(run, pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import contextlib, io
        from safety_harness.base.compiling import Compilation, watchers

        def test_compiles():
            with contextlib.redirect_stdout(io.StringIO()) as own:
                for watcher in watchers:
                    watcher(Compilation(ready=3, seconds=2.0, going_on=True))
                print("still its own")
            assert own.getvalue() == "still its own\\n"
        """
    )
    result = run()
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["compiling the control stack for this machine, *so far: 3, 2 s"])
    run("-s").stdout.fnmatch_lines(["compiling the control stack *"])
    run("-p", "no:terminal").stdout.no_fnmatch_line("compiling*")


def test_what_no_run_of_the_session_tried_is_named(run, project: Path) -> None:
    text = (project / "reaches.yaml").read_text().replace("scenario space:", "scenario:")
    late = "      - wait: 5 s\n      - withdraw: 1 m/s\nclaims:\n  TCP speed never above 900 mm/s: holds\n"
    moves = text[: text.index("      - reach")] + late
    (project / "idle.yaml").write_text(moves)
    result = run("idle.yaml", "--safety-world", "kinematic")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(
        [
            "note: TCP speed never above 900 mm/s: no run came near its limit; *",
            "untried in 1 run of *, and nothing is known of: move 2 of right hand (withdraw)",
        ]
    )


def test_a_test_that_never_simulates_fails_and_a_swallowed_violation_is_named(run, project: Path) -> None:
    (project / "test_it.py").write_text(
        "import pytest\n"
        "from safety_harness import InputError\n"
        "from safety_harness.testing import assert_holds, hand_distance, mm\n"
        "CLAIM = hand_distance() > mm(50)\n"
        "def test_no_files(simulate):\n"
        "    for file in []:\n"
        "        assert_holds(CLAIM, simulate(file))\n"
        "def test_refused(simulate):\n"
        "    with pytest.raises(InputError):\n"
        "        simulate('nowhere.yaml')\n"
        "@pytest.mark.judges_runs_itself\n"
        "def test_marked(simulate):\n"
        "    assert simulate\n"
        "def test_swallowed(simulate):\n"
        "    try:\n"
        "        assert_holds(CLAIM, simulate('fast.yaml'))\n"
        "    except Exception:\n"
        "        pass\n"
    )
    result = run("test_it.py")
    result.assert_outcomes(passed=3, failed=1)
    result.stdout.fnmatch_lines(
        [
            "simulate was never called: no run was made, and nothing was put to the test",
            "*test_it.py::test_swallowed passed, although assert_holds failed in it",
        ]
    )


def test_a_failure_that_a_hook_makes_a_pass_is_named_and_an_earlier_report_is_not_this_sessions(
    run, project: Path
) -> None:
    (project / "test_it.py").write_text(
        "from safety_harness.testing import assert_holds\n"
        "def test_broken(simulate):\n"
        "    assert_holds('always hand distance > 50 mm', simulate('fast.yaml'))\n"
    )
    (project / "conftest.py").write_text(
        "import pytest\n"
        "@pytest.hookimpl(wrapper=True)\n"
        "def pytest_runtest_makereport(item, call):\n"
        "    report = yield\n"
        "    report.outcome = 'passed'\n"
        "    return report\n"
    )
    named = run("test_it.py", "--safety-report", "r.html")
    named.stdout.fnmatch_lines(["*test_it.py::test_broken passed, although assert_holds failed in it"])
    skipped = "import pytest\n@pytest.mark.skip\ndef test_broken(simulate): simulate('fast.yaml')\n"
    (project / "test_it.py").write_text(skipped)
    later = run("test_it.py", "--safety-report", "r.html")
    later.stdout.fnmatch_lines(["nothing was judged: *r.html is of an earlier session"])


@pytest.mark.parametrize("asked", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_an_end_from_outside_keeps_the_report_of_what_was_judged(run, project: Path, asked: str) -> None:
    if signal.getsignal(signal.Signals[asked]) is signal.SIG_IGN:
        pytest.skip("nohup ignores it, and so do its programs")
    ends = f"import os, signal\n\ndef test_ends():\n    os.kill(os.getpid(), signal.{asked})\n"
    (project / "test_ends.py").write_text(ends)
    ended = run("fine.yaml", "test_ends.py", "--safety-report=out/report.html")
    assert ended.ret == pytest.ExitCode.INTERRUPTED
    assert (project / "out" / "report.html").is_file()
    assert DISTANCE in (project / "out" / "report.json").read_text()
