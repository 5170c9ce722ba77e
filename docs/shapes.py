"""For the API reference: the shape of its type and the comment beside it describe a parameter or a field."""

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


class Comments(griffe.Extension):
    """``start: NDArray[np.float64],  # (3,) [m]`` becomes a line of the list below the docstring.

    And so does ``start: Array3,  # [m]``, since ``base/geometry/arrays.py`` says the shape of an Array3.
    """

    def __init__(self) -> None:
        self._read: dict[Path, dict[int, str]] = {}

    def on_function_instance(self, *, node: Any, func: griffe.Function, **_: Any) -> None:
        """The parameters."""
        if isinstance(node, ast.FunctionDef):
            given = node.args.posonlyargs + node.args.args + node.args.kwonlyargs
            self._describe(func, {one.arg: one for one in given})

    def on_class_instance(self, *, node: Any, cls: griffe.Class, **_: Any) -> None:
        """The fields."""
        if isinstance(node, ast.ClassDef):
            fields = [one for one in node.body if isinstance(one, ast.AnnAssign)]
            self._describe(cls, {ast.unparse(one.target): one for one in fields})

    def _describe(
        self, what: griffe.Function | griffe.Class, given: dict[str, ast.arg] | dict[str, ast.AnnAssign]
    ) -> None:
        if what.docstring is not None and isinstance(what.filepath, Path):
            lines = []
            for name, one in given.items():
                shape = SHAPES.get(ast.unparse(one.annotation) if one.annotation else "", "")
                text = f"{shape} {self._beside(what.filepath, one.end_lineno)}".strip()
                lines += [f"- `{name}`: {text}"] * bool(text)
            what.docstring.value += "\n\n" * bool(lines) + "\n".join(lines)

    def _beside(self, file: Path, line: int | None) -> str:
        """The comment at the end of a line, but for one that is for a tool."""
        if file not in self._read:
            tokens = tokenize.generate_tokens(io.StringIO(file.read_text(encoding="utf-8")).readline)
            comments = (token for token in tokens if token.type == tokenize.COMMENT)
            self._read[file] = {token.start[0]: token.string.lstrip("# ") for token in comments}
        text = self._read[file].get(line or 0, "")
        return "" if text.startswith(("noqa", "type:")) else text
