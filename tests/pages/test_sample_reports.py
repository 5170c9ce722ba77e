"""reports/sample/ has a page of each kind, small, of this version's schemas, and names nobody's folders."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path

import jsonschema
import pytest

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "reports" / "sample"


def made_by() -> dict[str, str]:
    spec = importlib.util.spec_from_file_location("sample_reports", ROOT / "benchmarks" / "sample_reports.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return dict(module.COMMANDS)


def test_there_is_a_page_of_each_kind_and_the_readme_names_it() -> None:
    kinds = made_by()
    assert {folder.name for folder in SAMPLE.iterdir()} == set(kinds)
    readme = (SAMPLE.parent / "README.md").read_text()
    for kind in kinds:
        (page,) = (SAMPLE / kind).glob("*.html")
        assert f"`sample/{kind}`" in readme
        assert "</html>" in page.read_text()
    assert sum(file.stat().st_size for file in SAMPLE.rglob("*") if file.is_file()) < 4e6


@pytest.mark.parametrize(("file", "schema"), [("run/report", "report"), ("evidence/evidence", "evidence")])
def test_the_documents_are_of_this_version_s_schema(file: str, schema: str) -> None:
    document = json.loads((SAMPLE / f"{file}.json").read_text())
    published = json.loads((ROOT / "docs" / "schema" / f"{schema}.schema.json").read_text())
    jsonschema.Draft202012Validator(published).validate(document)


def test_no_page_names_a_folder_of_the_machine_that_made_it() -> None:
    for file in SAMPLE.rglob("*.*"):
        text = file.read_text()
        assert not any(folder in text for folder in ("/tmp/", "/home/", "/root/", "/work/")), file
