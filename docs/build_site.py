"""The site, into site/: python docs/build_site.py [FOLDER] (make docs); with --release, into FOLDER/VERSION.

Released sites lie side by side in one folder; on a server each of them lets its reader choose another.
What a page links to in the repository becomes a page as well; the build fails for a broken link and for a
page that would fetch anything from elsewhere.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from html.parser import HTMLParser
from pathlib import Path
from tempfile import TemporaryDirectory

import yaml

from safety_harness.base.distribution import installed_version
from safety_harness.extensions.arms.page import shipped_robots, write_arm_page

ROOT = Path(__file__).parents[1]
LINK = re.compile(r"\]\(([^)#\s:]+)(#[^)\s]*)?\)")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".json": "json", ".toml": "toml"}
FETCHED = {"script": "src", "img": "src", "iframe": "src", "link": "href", "source": "src"}
ARMS = "results/arms.html"  # a page of 3-D views, made where the site has it
MOVED = "moved.yaml"  # safety-harness docs reads it from the site
NO_PAGES = shutil.ignore_patterns("*.py", "*.json", MOVED, "__pycache__")


def build(root: Path, out: Path, *, released: bool = False) -> None:
    """The site of ``root``/docs, as ``root``/mkdocs.yml has it; SystemExit with what is wrong.

    One that is ``released`` asks its server which others there are.
    """
    settings = yaml.safe_load((root / "mkdocs.yml").read_text(encoding="utf-8"))
    if released:
        settings["extra"]["version"] = {"provider": "mike"}  # the form of versions.json
    with TemporaryDirectory() as folder:
        work = Path(folder)
        shutil.copytree(root / "docs", work / "docs", ignore=NO_PAGES)
        _add_linked_files(root / "docs", work / "docs")
        if ARMS in json.dumps(settings["nav"]):
            write_arm_page(
                work / "docs" / ARMS, shipped_robots(), title="The shipped arms and their capsules"
            )
        python = next(one["mkdocstrings"] for one in settings["plugins"] if isinstance(one, dict))
        python["handlers"]["python"]["paths"] = [str(ROOT)]
        python["handlers"]["python"]["options"]["extensions"] = [str(ROOT / "docs" / "shapes.py")]
        settings |= {"site_dir": "site"} | _repository(root)
        (work / "mkdocs.yml").write_text(yaml.safe_dump(settings), encoding="utf-8")
        command = [Path(sys.executable).with_name("zensical"), "build", "--strict"]
        done = subprocess.run(command, cwd=work, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(re.sub(r"\x1b\[[\d;]*m", "", done.stdout + done.stderr))
        for file in sorted((work / "site").rglob("*.html")):
            for what in fetched(file.read_text(encoding="utf-8")):
                name = file.relative_to(work / "site")
                raise SystemExit(f"{name}: fetches {what}; the site has to be readable without a network")
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(work / "site", out)
    for file in (root / "docs").glob(MOVED):
        shutil.copy(file, out)


def _repository(root: Path) -> dict[str, str]:
    """A link to where this checkout came from, if that is an address for browsers."""
    command = ["git", "-C", str(root), "remote", "get-url", "origin"]
    address = subprocess.run(command, capture_output=True, text=True).stdout.strip().removesuffix(".git")
    return {"repo_url": address} if address.startswith("https://") else {}


def _add_linked_files(source: Path, target: Path) -> None:
    """A page for each file or folder outside docs/ (or of data within it) that a page links to."""
    wanted: set[Path] = set()
    for page in sorted(source.rglob("*.md")):
        text = page.read_text(encoding="utf-8")
        up = "../" * (len(page.relative_to(source).parts) - 1)
        for link, path in _outside(page, text, source):
            wanted.add(path)
            text = re.sub(rf"\]\({re.escape(link)}(?=[)#])", f"]({up}{_place(path)}", text)
        (target / page.relative_to(source)).write_text(text, encoding="utf-8")
    for path in sorted(wanted):
        place = target / _place(path)
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(_shown(path), encoding="utf-8")


def _outside(page: Path, text: str, docs: Path) -> Iterator[tuple[str, Path]]:
    """(link, path) of what a page links to that is there and is no page itself."""
    for match in LINK.finditer(text):
        path = (page.parent / match[1]).resolve()
        within = path.is_relative_to(docs) and path.suffix not in (".json", ".py")
        if path.is_relative_to(ROOT) and path.exists() and not within:
            yield match[1], path


def _place(path: Path) -> str:
    """Of its page; a report is its own."""
    return f"repository/{path.relative_to(ROOT)}" + ("" if path.suffix == ".html" else ".md")


def _shown(path: Path) -> str:
    """The text of a file, or of all files of a folder."""
    if path.suffix == ".html":
        return path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return _without_files(path)
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


def _without_files(path: Path) -> str:
    """A Markdown file: its links to pages of the site lead there, those to other files are words."""
    up = "../" * len(path.relative_to(ROOT).parts)

    def again(match: re.Match[str]) -> str:
        there = (path.parent / match[1]).resolve()
        if there.is_relative_to(ROOT / "docs") and there.suffix == ".md":
            return f"]({up}{there.relative_to(ROOT / 'docs')}{match[2] or ''})"
        return "]"

    return LINK.sub(again, path.read_text(encoding="utf-8"))


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


def release(root: Path, out: Path, version: str) -> None:
    """The site of ``version`` beside those that are in ``out``, and where the newest is."""
    build(root, out / version, released=True)
    found = sorted((one for one in out.iterdir() if (one / "index.html").is_file()), key=_number)
    versions = [{"version": one.name, "title": one.name, "aliases": []} for one in reversed(found)]
    versions[0]["aliases"] = ["latest"]
    (out / "versions.json").write_text(json.dumps(versions, indent=1) + "\n", encoding="utf-8")
    newest = (
        f'<!DOCTYPE html><title>The newest</title><meta http-equiv="refresh" content="0; {found[-1].name}/">'
    )
    (out / "index.html").write_text(newest + "\n", encoding="utf-8")


def _number(site: Path) -> list[int]:
    return [int(part) for part in re.findall(r"\d+", site.name)]


def main(arguments: Sequence[str] = ()) -> None:
    """Build, and say where."""
    folders = [one for one in arguments if one != "--release"]
    out = Path(folders[0]) if folders else ROOT / "site"
    if "--release" in arguments:
        release(ROOT, out, installed_version())
    else:
        build(ROOT, out)
    sys.stdout.write(f"{out / 'index.html'}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
