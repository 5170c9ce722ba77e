"""Count the constructions that make a sentence hard to read: ``python docs/prose.py PAGE...``.

Reads Markdown without its code, tables and headings, and prints how many constructions 100 sentences have,
then the ten worst sentences.  The rules come from a comparison with the documents of Hypothesis and pytest,
which have 11 and 16 of these constructions in 100 sentences.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

HARD = {
    "over 30 words": r"^(?:\S+\s+){30}\S+",
    "two or more colons or semicolons": r"[:;]\s.*[:;]\s",
    "'what X is' as a noun": r"(?<=.)\b(?:[Ww]hat|that which|whatever|as far as)\b"
    r"(?! (?:kind|sort|if|about)\b)(?!.*\?$)",
    "begins with Of, As, What, With": r"^(?:Of|As|What|Whatever|With|From|By|In place of) ",
    "is told, said, named, asked, tried": r"\b(?:is|are|was|were|be|been)(?: \w+)? "
    r"(?:told|said|named|asked|tried|taken|kept|left|made|shown|held)\b",
    "no X is Y, but for, none": r"\bbut for\b|\bnone\b|^No \w+|\bnothing\b|\bnobody\b|\bneither\b",
    "one, others, those as nouns": r"\b(?:this|that|the|an?|no|each|every) (?:one|other|others)\b(?! \w+ing)"
    r"|\bthose (?:that|of|who)\b|\b(?:one|that) of (?:a|an|the|its)\b",
    "relative clause before its verb": r"^(?:Who|Where|Whose|That|Which) \w+",
}


def sentences(text: str) -> Iterator[str]:
    """Yield each sentence of a page that has at least four words."""
    text = re.sub(r"(?ms)^(```|~~~).*?^\1", "", text)
    text = re.sub(r"(?m)^\s*(\||#|<|!\[|:\w+:|    ).*$", "", text)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )", text):
        flat = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", " ".join(block.split()))
        flat = re.sub(r"^\s*(?:[-*]|\d+\.)\s+", "", re.sub(r"`+[^`]*`+", "NAME", flat)).replace("**", "")
        for sentence in re.split(r"(?<=[.!?])\s+(?=[A-Z`\"'(])", flat):
            if len(sentence.split()) >= 4 and re.search(r"[.!?:]$", sentence):
                yield sentence


def words(text: str) -> int:
    """Return how many words of a page people wrote: all but generated tables, code and addresses."""
    tables = r"<!-- (?:table|printed by): .*?<!-- end -->"
    for written in (tables, r"<!--.*?-->", r"^```.*?^```$", r"(?<=\])\([^)]*\)"):
        text = re.sub(written, " ", text, flags=re.DOTALL | re.MULTILINE)
    return len(re.findall(r"[^\s|]*\w[^\s|]*", text))


def found_in(sentence: str) -> list[str]:
    """Return the names of the constructions in a sentence."""
    return [name for name, rule in HARD.items() if re.search(rule, sentence)]


def worst(found: list[tuple[str, list[str]]], most: int = 10) -> str:
    """Return the sentences with the most constructions, one a line."""
    ordered = sorted((one for one in found if one[1]), key=lambda one: -len(one[1]))
    return "\n".join(f"{'; '.join(names)}: {sentence}" for sentence, names in ordered[:most])


def main() -> None:
    """Print the count of each page."""
    for name in sys.argv[1:]:
        found = [(one, found_in(one)) for one in sentences(Path(name).read_text("utf-8"))]
        share = 100 * sum(len(names) for _, names in found) / max(len(found), 1)
        sys.stdout.write(f"{name}: {share:.1f} in 100 of {len(found)} sentences\n{worst(found)}\n")


if __name__ == "__main__":
    main()
