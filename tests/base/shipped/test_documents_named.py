"""Messages lead to sections of the documents that there are, also where there is no repository."""

from __future__ import annotations

import ast
import io
import json
import re
import subprocess
import tarfile
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import stale
from markdown.extensions.toc import slugify

import safety_harness
from safety_harness.base.shipped import documents
from safety_harness.cli.console import AS_EXPECTED, BAD_INPUT
from safety_harness.cli.shipped import docs

ROOT = Path(__file__).parents[3]
PACKAGE = Path(safety_harness.__file__).parent
NAMED = re.compile(r"safety-harness docs ([a-z][a-z/-]*(?:#[a-z0-9-]+)?)")
LINKED = re.compile(r"\]\(([a-z/-]+)\.md(#[a-z0-9-]+)?\)")  # explain makes "safety-harness docs" of it
IN_A_ROW = re.compile(r"""["']\s*[bfru]*["']""", re.IGNORECASE)  # between two pieces of one text
SOURCES = [*PACKAGE.rglob("*.py"), *PACKAGE.rglob("*.j2"), *(ROOT / "examples").rglob("*.py")]


def named_in(text: str) -> set[str]:
    """Sections as ``safety-harness docs`` takes them."""
    joined = re.sub(r'"\n\s*f?"', "", text)
    return {*NAMED.findall(joined), *(page + place for page, place in LINKED.findall(joined))}


def sections_of(name: str, text: str) -> Iterator[str]:
    """A page and its headings, as the site calls them."""
    yield name
    seen: Counter[str] = Counter()
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        words = slugify(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", heading).replace("`", ""), "-")
        yield f"{name}#{words}" + (f"_{seen[words]}" if seen[words] else "")
        seen[words] += 1


@cache
def names_of_sections() -> set[str]:
    """Pages and headings of the Markdown."""
    pages = {
        page.relative_to(ROOT / "docs"): page.read_text("utf-8") for page in (ROOT / "docs").rglob("*.md")
    }
    return {one for page, text in pages.items() for one in sections_of(page.with_suffix("").as_posix(), text)}


def test_every_section_that_is_named_is_there() -> None:
    named = set().union(*(named_in(source.read_text("utf-8")) for source in SOURCES))
    assert len(named) > 5
    assert named - names_of_sections() == set()


MOVED = dict(
    line.split(": ", 1) for line in (ROOT / "docs" / "moved.yaml").read_text("utf-8").splitlines()[1:]
)
FLAT = ("dbfdc93f", "34853783")  # revisions with all pages in one folder


def test_every_moved_section_is_there() -> None:
    assert len(MOVED) > 500
    assert {old: now for old, now in MOVED.items() if now not in names_of_sections()} == {}


@pytest.mark.skipif(not stale.history(), reason="git's whole history is not here")
@pytest.mark.parametrize("revision", FLAT)
def test_every_section_of_the_flat_folder_is_in_the_map(revision: str) -> None:
    packed = subprocess.run(
        ("git", "archive", revision, "docs"), cwd=ROOT, check=True, capture_output=True
    ).stdout
    old = set()
    with tarfile.open(fileobj=io.BytesIO(packed)) as archive:
        for member in archive:
            if member.name.endswith(".md") and (file := archive.extractfile(member)):
                old |= {*sections_of(member.name[len("docs/") : -len(".md")], file.read().decode())}
    assert len(old) > 400
    assert old - MOVED.keys() == set()


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
    if "docs/" not in IN_A_ROW.sub("", text):  # no words of it have that
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
    moved = "# Old: now.\nsentences: claims\nsentences#leads-away: claims#proposals-lead-away\n"
    (tmp_path / "moved.yaml").write_text(moved)
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
        (["sentences"], "claims.html"),
        (["sentences#leads-away"], "claims.html#proposals-lead-away"),
        (["sentences#proposals-lead-away"], "claims.html#proposals-lead-away"),
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


@pytest.fixture
def no_site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(documents, "site", lambda: tmp_path / "none")


@pytest.mark.usefixtures("no_site")
def test_without_a_site_the_markdown_has_the_same_sections() -> None:
    assert {section.name for section in documents.sections()} == names_of_sections()


@pytest.mark.usefixtures("no_site")
@pytest.mark.parametrize(
    ("words", "place"),
    [
        ([], "index.md"),
        (["how-to/avoider"], "how-to/avoider.md"),
        (["how-to/avoider#a-python-file"], "how-to/avoider.md#a-python-file"),
        (["state-table"], "reference/controller.md"),
    ],
)
def test_without_a_site_the_markdown_is_found(
    words: list[str], place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert docs(words) == AS_EXPECTED
    assert capsys.readouterr().out == f"{ROOT}/docs/{place}\n"


@pytest.mark.usefixtures("no_site")
def test_the_text_of_a_section_ends_before_the_next() -> None:
    section = documents.section_named("how-to/avoider#a-python-file")
    page = (ROOT / "docs/how-to/avoider.md").read_text()
    text = documents.text_of(section)
    assert text in page
    assert text.startswith("## ")
    assert text.count("\n## ") == 0
    whole = documents.text_of(documents.section_named("how-to/avoider"))
    assert whole == page[page.index("# ") :].rstrip("\n")
