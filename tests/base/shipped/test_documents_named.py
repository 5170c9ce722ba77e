"""Messages lead to sections of the documents that there are, also where there is no repository."""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest
from markdown.extensions.toc import slugify

import safety_harness
from safety_harness.base.shipped import documents
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.shipped import docs

ROOT = Path(__file__).parents[3]
PACKAGE = Path(safety_harness.__file__).parent
NAMED = re.compile(r"safety-harness docs ([a-z][a-z/-]*(?:#[a-z0-9-]+)?)")
LINKED = re.compile(r"\]\(([a-z-]+)\.md(#[a-z0-9-]+)?\)")  # explain makes "safety-harness docs" of it
SOURCES = [*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.j2"), *(ROOT / "examples").rglob("*.py")]


def named_in(text: str) -> set[str]:
    """Sections as ``safety-harness docs`` takes them."""
    joined = re.sub(r'"\n\s*f?"', "", text)
    return {*NAMED.findall(joined), *(page + place for page, place in LINKED.findall(joined))}


def names_of_sections() -> set[str]:
    """Pages and headings of the Markdown, as the site calls them."""
    found = set()
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs").with_suffix("").as_posix()
        text = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
        headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        found |= {name, *(f"{name}#{slugify(heading.replace('`', ''), '-')}" for heading in headings)}
    return found


def test_every_section_that_is_named_is_there() -> None:
    named = set().union(*(named_in(source.read_text("utf-8")) for source in SOURCES))
    assert len(named) > 5
    assert named - names_of_sections() == set()


def test_the_test_sees_a_section_that_is_not_there() -> None:
    assert named_in('hint="safety-harness docs " "avoiders#nowhere"') == set()
    assert named_in('hint="see safety-harness docs avoiders#nowhere"') == {"avoiders#nowhere"}
    assert "avoiders#nowhere" not in names_of_sections()


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.name)
def test_no_message_names_a_markdown_file_of_the_repository(source: Path) -> None:
    """A docstring may: who reads it has the repository.  It names a file that is there."""
    text = source.read_text("utf-8")
    assert all((ROOT / name).is_file() for name in re.findall(r"\bdocs/[\w/-]+\.\w+", text))
    if source.suffix != ".py":
        return
    tree = ast.parse(text)
    documented = {ast.get_docstring(node, clean=False) for node in ast.walk(tree) if _has_docstring(node)}
    texts = (node.value for node in ast.walk(tree) if isinstance(node, ast.Constant))
    shown = [one for one in texts if isinstance(one, str) and one not in documented]
    assert [one for one in shown if re.search(r"docs/[\w-]+\.md", one)] == []


def _has_docstring(node: ast.AST) -> bool:
    return isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)


@pytest.fixture
def small_site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A site of two pages, as the build leaves it."""
    monkeypatch.setattr(documents, "site", lambda: tmp_path)
    found = [
        {"location": "index.html", "title": "Start"},
        {"location": "claims.html", "title": "The catalogue of claims"},
        {"location": "claims.html#proposals-lead-away", "title": "proposals lead away"},
    ]
    (tmp_path / "search.json").write_text(json.dumps({"items": found}))
    for page in ("index.html", "claims.html"):
        (tmp_path / page).write_text("")
    return tmp_path


@pytest.mark.parametrize(
    ("words", "place"),
    [
        ([], "index.html"),
        (["claims"], "claims.html"),
        (["claims#proposals-lead-away"], "claims.html#proposals-lead-away"),
        (["claims#proposals"], "claims.html#proposals-lead-away"),
        (["lead", "away"], "claims.html#proposals-lead-away"),
        (["Catalogue"], "claims.html"),
    ],
)
def test_a_section_is_found_and_without_a_terminal_only_told(
    words: list[str], place: str, small_site: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert docs(words) == AS_EXPECTED
    assert capsys.readouterr().out == f"{small_site}/{place}\n"


def test_an_unknown_section_gets_the_nearest(small_site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert docs(["clams"]) == BAD_INPUT
    assert 'did you mean "claims' in capsys.readouterr().err


def test_without_a_site_it_says_where_the_markdown_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(documents, "site", lambda: tmp_path / "none")
    for words in ([], ["claims"]):
        assert docs(words) == BAD_INPUT
        told = capsys.readouterr().err
        assert "make docs" in told
        assert str(ROOT / "docs") in told
