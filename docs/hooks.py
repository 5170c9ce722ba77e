"""Hooks of the site: linked files of the repository become pages, and nothing is fetched when it is read."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

from safety_harness.report.arm_page import shipped_robots, write_arm_page

ARMS = "arms.html"
ROOT = Path(__file__).parents[1]
LINK = re.compile(r"\]\(([^)#\s:]+)(#[^)\s]*)?\)")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".json": "json", ".toml": "toml"}
FETCHED = {"script": "src", "img": "src", "iframe": "src", "link": "href", "source": "src"}


def on_files(files: Files, config: Any) -> Files:
    """A page for each file or folder outside docs/ (or of data within it) that a page links to; the arms."""
    wanted: set[Path] = set()
    for file in files.documentation_pages():
        wanted |= {outside for _, outside in _outside(file)}
    for path in sorted(wanted):
        files.append(File.generated(config, _page(path), content=_shown(path)))
    with TemporaryDirectory() as folder:
        page = Path(folder) / ARMS
        write_arm_page(page, shipped_robots(), title="The shipped arms and their capsules")
        files.append(File.generated(config, ARMS, content=page.read_text(encoding="utf-8")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links to those files lead to their pages."""
    up = "../" * page.file.src_uri.count("/")
    for link, path in _outside(page.file):
        markdown = re.sub(rf"\]\({re.escape(link)}(?=[)#])", f"]({up}{_page(path)}", markdown)
    return markdown


def on_post_build(config: Any) -> None:
    """Fail if a page of the site would fetch anything from elsewhere."""
    for file in sorted(Path(config["site_dir"]).rglob("*.html")):
        for what in fetched(file.read_text(encoding="utf-8")):
            raise PluginError(f"{file}: fetches {what}; the site has to be readable without a network")


def fetched(html: str) -> list[str]:
    """What a page takes from other hosts by itself: scripts, styles, fonts, pictures; not links to follow."""
    finder = _Finder()
    finder.feed(html)
    return finder.found


class _Finder(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        address = dict(attrs).get(FETCHED.get(tag, "")) or ""
        if re.match(r"(https?:)?//", address) and dict(attrs).get("rel") != "canonical":
            self.found.append(address)


def _outside(file: File) -> list[tuple[str, Path]]:
    """(link, path) of what a page links to that is there and is no page itself."""
    if file.abs_src_path is None:
        return []  # one of our own making
    source = Path(file.abs_src_path)
    found = []
    for match in LINK.finditer(source.read_text(encoding="utf-8")):
        path = (source.parent / match[1]).resolve()
        within = path.is_relative_to(ROOT / "docs") and path.suffix != ".json"
        if path.is_relative_to(ROOT) and path.exists() and not within:
            found.append((match[1], path))
    return found


def _page(path: Path) -> str:
    return f"repository/{path.relative_to(ROOT)}.md"


def _shown(path: Path) -> str:
    """The text of a file, or of all files of a folder."""
    if path.suffix == ".md":  # of one at the root, docs/ is the root of the site
        return path.read_text(encoding="utf-8").replace("](docs/", "](../")
    texts = [f"# {path.relative_to(ROOT)}"]
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*.*") if "__pycache__" not in p.parts)
    for file in files:
        fence = "`" * 4
        title = "" if file == path else f"## {file.relative_to(path)}\n\n"
        body = file.read_text(encoding="utf-8")
        if len(body) > 200_000:
            body = "(data; see the repository)"
        texts.append(f"{title}{fence}{LANGUAGES.get(file.suffix, 'text')}\n{body.rstrip()}\n{fence}")
    return "\n\n".join(texts) + "\n"
