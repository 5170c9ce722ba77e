"""The public names are there, all of them, and no others; and importing the package is quick work."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

import safety_harness
from safety_harness.base.exceptions import MissingPackageError

PACKAGE = Path(safety_harness.__file__).parent


def test_every_public_name_can_be_imported() -> None:
    for name in safety_harness.__all__:
        assert getattr(safety_harness, name) is not None


def test_a_type_checker_sees_each_public_name_at_the_home_that_it_is_imported_from() -> None:
    tree = ast.parse(Path(safety_harness.__file__).read_text(encoding="utf-8"))
    homes = {
        alias.name: node.module or ""
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("safety_harness.")
        for alias in node.names
    }
    assert sorted(homes) == sorted(safety_harness.__all__)
    for name, home in homes.items():
        assert getattr(safety_harness, name) is getattr(import_module(home), name)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'amdit'"):
        safety_harness.amdit  # noqa: B018


def test_the_names_of_wings_are_as_the_wings_have_them() -> None:
    """If not: python docs/tables.py."""
    named = {}
    for file in sorted((PACKAGE / "extensions").glob("*/*.py")):
        found = re.search(r"^__all__ = (\[.*?\])", file.read_text(encoding="utf-8"), re.M | re.S)
        if found:
            module = ".".join(file.relative_to(PACKAGE).with_suffix("").parts)
            named[module] = tuple(sorted(ast.literal_eval(found[1])))
    assert named == safety_harness._WINGS


def test_a_wing_that_is_absent_is_named_with_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "safety_harness.extensions.lab", None)
    monkeypatch.delitem(sys.modules, "safety_harness.extensions.lab.prove_job", raising=False)
    with pytest.raises(MissingPackageError, match=r"safety_harness\.prove: needs .*lab.*pip install"):
        safety_harness.prove  # noqa: B018


def test_importing_the_package_loads_neither_numba_nor_pybullet() -> None:
    code = "import sys, safety_harness; print([m for m in ('numba', 'pybullet', 'cv2') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


def test_the_example_of_the_package_docstring_runs(capsys: pytest.CaptureFixture[str]) -> None:
    doc = safety_harness.__doc__ or ""
    code = "\n".join(line.removeprefix("    ") for line in doc.splitlines() if line.startswith("    "))
    exec(compile(code, "docstring", "exec"), {})
    assert "hand distance never below 50 mm holds" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("owner", "old", "new"),
    [
        ("base.output:Output", "words", "messages"),
        ("base.geometry.regions:Box", "about", "centred_at"),
        ("search.cube:Cube", "of", "from_space"),
        ("search.findings:Goal", "of", "from_property"),
        ("search.findings:Findings", "found", "found_any"),
        ("report.evidence:JudgedRun", "under", "under_claim"),
        ("search.attribution.attribute:Attribution", "words", "summary"),
        ("search.attribution.tally:AttributionTally", "of", "from_attributions"),
        ("search.attribution.tally:AttributionTally", "words", "summary"),
        ("extensions.field.monitoring.monitor:VerdictLine", "told", "as_dict"),
    ],
)
def test_an_old_name_is_the_new_one_for_one_release(owner: str, old: str, new: str) -> None:
    module, _, name = owner.partition(":")
    cls = getattr(import_module(f"safety_harness.{module}"), name)
    assert vars(cls)[old] is vars(cls)[new]


def test_an_old_keyword_works_for_one_release_and_an_unknown_one_does_not() -> None:
    from safety_harness.testing import always, eventually, s, servoing, stopped

    old: Any = always
    assert str(old(stopped(), within=s(2))) == str(always(stopped(), window=s(2))) == "always for 2 s stopped"
    old = eventually
    assert old(stopped(), within=s(2)) == eventually(stopped(), window=s(2))
    old = stopped().until
    assert str(old(servoing(), within=s(2))) == str(stopped().until(servoing(), window=s(2)))
    with pytest.raises(TypeError, match="whitin"):
        old(servoing(), whitin=s(2))


def test_a_keyword_and_its_old_name_together_are_refused() -> None:
    from safety_harness.testing import always, s, stopped

    old: Any = always
    with pytest.raises(TypeError, match="window or its old name within; got both"):
        old(stopped(), window=s(1), within=s(2))
