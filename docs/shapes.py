"""Add shapes and units to the API reference: from a parameter's type and the comment beside it.

The reference renders the sections ``Args``, ``Attributes``, ``Returns`` and ``Raises`` as tables.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from pathlib import Path
from typing import Any

import griffe

ARRAYS = Path(__file__).parents[1] / "safety_harness" / "base" / "geometry" / "arrays.py"
SHAPES = dict(re.findall(r"^(\w+) = NDArray.*?# (\(.*?\))", ARRAYS.read_text(encoding="utf-8"), re.MULTILINE))
SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields):$")


class Comments(griffe.Extension):
    """Add ``start: NDArray[np.float64],  # (3,) [m]`` to the table of parameters or attributes as "(3,) [m]".

    For ``start: Array3,  # [m]`` the shape comes from ``base/geometry/arrays.py``.
    """

    def __init__(self) -> None:
        self._comments: dict[Path, dict[int, str]] = {}

    def on_function_instance(self, *, node: Any, func: griffe.Function, **_: Any) -> None:
        """Describe the parameters of a function."""
        if isinstance(node, ast.FunctionDef):
            arguments = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
            self._describe(func, "Args", {argument.arg: argument for argument in arguments})

    def on_class_instance(self, *, node: Any, cls: griffe.Class, **_: Any) -> None:
        """Describe the fields of a class."""
        if isinstance(node, ast.ClassDef):
            fields = [statement for statement in node.body if isinstance(statement, ast.AnnAssign)]
            documented = cls.docstring is not None and "Args:" in cls.docstring.value.splitlines()
            section = "Args" if documented else "Attributes"
            self._describe(cls, section, {ast.unparse(field.target): field for field in fields})

    def _describe(
        self,
        documented: griffe.Function | griffe.Class,
        section: str,
        parameters: dict[str, ast.arg] | dict[str, ast.AnnAssign],
    ) -> None:
        if documented.docstring is None or not isinstance(documented.filepath, Path):
            return
        for name, node in parameters.items():
            shape = SHAPES.get(ast.unparse(node.annotation) if node.annotation else "", "")
            text = f"{shape} {self._comment(documented.filepath, node.end_lineno)}".strip()
            if text:
                documented.docstring.value = with_entry(documented.docstring.value, section, name, text)

    def _comment(self, file: Path, line: int | None) -> str:
        """Return the comment at the end of a line; "" for a comment that addresses a tool."""
        if file not in self._comments:
            tokens = tokenize.generate_tokens(io.StringIO(file.read_text(encoding="utf-8")).readline)
            comments = (token for token in tokens if token.type == tokenize.COMMENT)
            self._comments[file] = {token.start[0]: token.string.lstrip("# ") for token in comments}
        text = self._comments[file].get(line or 0, "")
        return "" if text.startswith(("noqa", "type:")) else text


def with_entry(docstring: str, section: str, name: str, text: str) -> str:
    """Return a docstring whose section describes a parameter by a text, in front of other words about it.

    Args:
        docstring: A docstring without indentation.
        section: ``Args`` or ``Attributes``; where it is missing, it comes before the other sections.
        name: The parameter or field.
        text: Shape and unit, from the source.

    """
    lines = docstring.splitlines()
    if f"{section}:" not in lines:
        first = next((i for i, line in enumerate(lines) if SECTION.match(line)), len(lines))
        lines[first:first] = ["", f"{section}:", f"    {name}: {text}", ""]
        return "\n".join(lines)
    start = lines.index(f"{section}:") + 1
    end = next((i for i in range(start, len(lines)) if not lines[i].startswith(" ")), len(lines))
    for i in range(start, end):
        if re.match(rf"\s+{re.escape(name)}\b[^:]*:", lines[i]):
            head, _, words = lines[i].partition(":")
            if text not in words:
                lines[i] = f"{head}: {text}. {words.strip()}"
            return "\n".join(lines)
    lines.insert(end, f"    {name}: {text}")
    return "\n".join(lines)
