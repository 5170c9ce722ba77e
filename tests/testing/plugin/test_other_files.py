"""Files of other programs: they are no scenarios, whatever words they use, and they end no session."""

from __future__ import annotations

from pathlib import Path

import pytest

from safety_harness.scenario.ours import is_ours
from tests.testing.plugin.conftest import CLAIMS, HEAD

OTHERS: dict[str, bytes] = {
    "conf/train.yaml": b"seed: 1\nrobot: ur10\ncamera:\n  width: 640\nhands: 2\nclaims: []\n",
    "conf/config.yaml": b"defaults:\n  - _self_\n  - robot: ur5\nhydra:\n  run: {dir: '${now:%Y}'}\n",
    "docker-compose.yaml": b"services:\n  web:\n    image: x\n    extends: base\n",
    ".github/workflows/ci.yaml": b"name: ci\non: push\njobs:\n  a:\n    strategy:\n      matrix: {a: [1]}\n",
    "k8s/deploy.yaml": b'apiVersion: v1\nkind: {{ .Values.kind }}\nm: {{- include "x" . }}\n---\na: 1\n',
    "mkdocs.yml": b"site_name: x\nmarkdown_extensions:\n  - emoji: !!python/name:material.twemoji\n",
    "molecule/default/molecule.yml": b"scenario:\n  name: default\ndriver:\n  name: docker\n",
    "ansible.yml": b"- hosts: all\n  scenario: local\n  tasks: []\n",
    "load-test.yaml": b"scenario: checkout\nusers: 10\n",
    "peak.yaml": b"scenario: checkout at peak\nduration: 5 m\nusers: 100\n",
    "api.yaml": b"suite: api\nseed: 1\nscenarios: [login, load-test.yaml]\n",
    "jwt.yaml": b"scenario: log in\nclaims: {sub: alice}\n",
    "chaos.yaml": b"scenario: chaos\nduration: 5 m\nfaults: [{kill: web}]\n",
    "street.yaml": b"scenario: a street\ncamera: {fov: 90}\nobject: car\nrobot: taxi\n",
    "helm_test.yaml": b"suite: deployment\ntemplates: [a.yaml]\ntests: []\n",
    "openapi.yaml": b"openapi: 3.0.0\ninfo: {title: x, version: '1'}\npaths: {}\n",
    "plan.yaml": b"plan: ours\nabout: scenario\nseed: 1\navoider: opposite pose\nstrata: []\nclaims: []\n",
    "empty.yaml": b"",
    "binary.yaml": bytes(range(256)) * 40,
    "latin.yaml": "scenario: fünf\nhands: []\n".encode("utf-16"),
    "broken.yaml": b"a: [1, 2\nb: }\n\t:\n",
    "huge.yaml": b"x: " + b"y" * 30_000_000,
}
TITLED = {
    *("load-test.yaml", "peak.yaml", "api.yaml", "jwt.yaml", "chaos.yaml", "street.yaml", "helm_test.yaml"),
}


def test_a_tree_of_other_programs_files_gives_no_item_and_no_error(run, pytester: pytest.Pytester) -> None:
    for name, data in OTHERS.items():
        path = pytester.path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        assert not is_ours(path), name
    pytester.makepyfile(test_other="def test_it(): pass")
    result = run("-rA", "conf", ".")
    result.assert_outcomes(passed=1)
    assert result.ret == pytest.ExitCode.OK
    (line,) = [line for line in result.outlines if line.startswith("safety-harness ignored ")]
    assert {name for name in OTHERS if name in line} == TITLED


@pytest.mark.parametrize("name", ["conf/train.yaml", "plan.yaml"])
def test_being_named_makes_no_scenario_of_a_file(run, pytester: pytest.Pytester, name: str) -> None:
    path = pytester.path / name
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(OTHERS[name])
    result = run(name)
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stdout.no_fnmatch_line("*expected*")


@pytest.mark.parametrize(
    ("text", "args"),
    [
        ("scenario: t\nhands: 3\n", ()),
        ("scenario: t\nhnads: []\nclaims: {no moving part touches a hand: holds}\n", ()),
        ("scenario: t\r\nduration: x\r\n", ("mine.yaml",)),
        ("suite: all\nscenarios: 3\n", ("mine.yaml",)),
    ],
)
def test_a_broken_file_of_ours_or_one_that_is_named_is_an_error_that_names_it(
    run, pytester: pytest.Pytester, text: str, args: tuple[str, ...]
) -> None:
    (pytester.path / "mine.yaml").write_bytes(text.encode())
    result = run(*args)
    assert result.ret == pytest.ExitCode.INTERRUPTED
    result.stdout.fnmatch_lines(["mine.yaml:*"])


def test_the_setting_names_the_scenario_files_and_no_other_is_one(run, pytester: pytest.Pytester) -> None:
    text = HEAD.format(title="scenario: t", speed="1 m/s") + CLAIMS.format(distance="holds")
    for folder in ("mine", "others"):
        (pytester.path / folder).mkdir()
        (pytester.path / folder / "a.yaml").write_text(text)
    (pytester.path / "mine" / "untitled.yaml").write_text(text.replace("scenario:", "scenaro:"))
    pytester.makeini("[pytest]\nsafety_scenarios = mine/*.yaml\n")
    result = run("--collect-only", "-q")
    result.stdout.fnmatch_lines(["mine/a.yaml::*", "mine/untitled.yaml:1: scenaro", "  hint * did you mean*"])
    result.stdout.no_fnmatch_line("others/*")
    pytester.makeini("[pytest]\nsafety_scenarios =\n")
    result = run("--collect-only", "-q")
    assert result.ret == pytest.ExitCode.NO_TESTS_COLLECTED


def test_a_pattern_of_the_setting_that_matches_nothing_ends_the_session(
    run, pytester: pytest.Pytester
) -> None:
    """Neither one that no file has, nor one of files where pytest does not look."""
    pytester.makepyfile(test_other="def test_it(): pass")
    (pytester.path / "mine").mkdir()
    (pytester.path / "mine" / "a.yaml").write_text(HEAD.format(title="scenario: t", speed="1 m/s"))
    for ini in (
        "safety_scenarios = mine/*.yml\n",
        "testpaths = test_other.py\nsafety_scenarios = mine/*.yaml\n",
    ):
        pytester.makeini(f"[pytest]\n{ini}")
        result = run()
        assert result.ret == pytest.ExitCode.USAGE_ERROR
        result.stderr.fnmatch_lines(["*safety_scenarios: expected a pattern * got 'mine/*"])


def test_a_child_file_is_ours_by_what_it_extends_whatever_its_title(run, project: Path) -> None:
    """Its violation is found, or its misspelt title told; it is never skipped in silence."""
    (project / "child.yml").write_text("extends: fast.yaml\n")
    (project / "below").mkdir()
    (project / "below" / "capital.YAML").write_text("Scenario: c\nextends: ../fast.yaml\n")
    result = run(".", "--collect-only", "-q")
    result.stdout.fnmatch_lines(
        ["child.yml::hand distance*", "below/capital.YAML:*", "*did you mean*scenario*"]
    )


MARKING = """\
import pathlib
pathlib.Path(__file__).with_name("executed").touch()
from safety_harness import Proposal


class Upwards:
    name = "upwards"

    def propose(self, *, hand_position_in_base_m, tcp_position_in_base_m, seed):
        return Proposal(tcp_position_in_base_m + [0.0, 0.0, 0.1])
"""
DRAWS = """\
from hypothesis import given
from safety_harness.testing import scenarios


@given(scenario=scenarios("space.yaml"))
def test_it(scenario, simulate):
    simulate(scenario)
"""


def test_collection_executes_no_avoider_and_a_run_says_that_it_does(run, pytester: pytest.Pytester) -> None:
    text = HEAD.format(title="scenario: t", speed="1 m/s") + CLAIMS.format(distance="violated")
    own = text.replace("opposite pose", "mine.py:Upwards")
    (pytester.path / "a.yaml").write_text(own)
    (pytester.path / "space.yaml").write_text(
        own.replace("scenario:", "scenario space:").replace(": 1 m/s", ": from 1 m/s to 2 m/s")
    )
    (pytester.path / "test_draws.py").write_text(DRAWS)
    (pytester.path / "mine.py").write_text(MARKING)
    marker = pytester.path / "executed"
    collected = run("--collect-only", "-q", "--avoider", "mine.py:Upwards")
    collected.stdout.fnmatch_lines(["a.yaml::*", "space.yaml::*", "test_draws.py::test_it"])
    assert not marker.exists()
    result = run("a.yaml")
    assert marker.exists()
    result.stdout.fnmatch_lines(["executed mine.py (sha256 ????????????), in a process of its own, as you"])


def test_an_avoider_that_does_not_import_ends_the_session_before_its_first_test(
    run, pytester: pytest.Pytester
) -> None:
    pytester.makepyfile(
        test_other="def test_it(): pass", mine="import nothing_of_this_name\nclass A: propose = 1"
    )
    result = run("--avoider", "mine.py:A")
    assert result.ret == pytest.ExitCode.USAGE_ERROR
    result.stderr.fnmatch_lines(["*nothing_of_this_name*"])
    assert run("--avoider", "mine.py:B").ret == pytest.ExitCode.USAGE_ERROR


def test_a_link_to_another_file_echoes_nothing_of_it(run, pytester: pytest.Pytester) -> None:
    secret = pytester.path / "secret"
    secret.write_text("scenario: t\nhands: hunter2\n")
    Path(pytester.path / "a.yaml").symlink_to(secret)
    assert run().ret == pytest.ExitCode.INTERRUPTED  # it has our keys: a scenario, and it is told
    secret.write_text("token: hunter2\n")
    result = run()
    assert result.ret == pytest.ExitCode.NO_TESTS_COLLECTED
    result.stdout.no_fnmatch_line("*hunter2*")
