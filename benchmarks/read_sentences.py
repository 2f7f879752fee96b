"""Draw sentences of the code and of the pages at random, to judge how plain they are.

python -m benchmarks.read_sentences --seed 1

Half of the sentences come from comments and docstrings of `src`, half from the prose of README.md and docs.
Tables, code, headings and the figures that programs fill in are left out. The same seed and the same text give the same
sentences.
"""

import argparse
import ast
import io
import random
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from benchmarks.common import ROOT

MIN_WORDS = 4
"""Fewest words of a sentence that is drawn. Shorter pieces are labels."""
SENTENCE_END = re.compile(r"(?<=[.!?])[\"')*]*\s+(?=[\"'(*]*[A-Z`])")
NOT_PROSE = re.compile(r"^\s*(\||#|!\[|<!--|>>>)")
"""Table rows, headings, pictures, marks and doctests."""
LABELS = re.compile(r"^\s*([A-Z]\w+\n\s*-{3,}|\w[\w, ]* : .*|\w+Error)$", flags=re.M)
"""Lines of a docstring that are no prose: underlined headings, names with types of parameters, names of errors."""
FIGURES = re.compile(r"<!-- (?:figures:(?!end)|ways:start).*?<!-- (?:figures|ways):end -->", flags=re.S)
"""Places of a page that programs fill."""
LIST_ITEM = re.compile(r"^\s*([-*]|\d+\.)\s+")


class Sentence(NamedTuple):
    """A sentence and the place where its first word stands."""

    path: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.text}"


def split_paragraph(path: Path, lines: list[tuple[int, str]]) -> Iterator[Sentence]:
    """Yield the sentences of a paragraph, which is given as numbered lines."""
    starts, text = [], ""
    for number, line in lines:
        starts.append((len(text), number))
        text += line.strip() + " "
    begin = 0
    for match in [*SENTENCE_END.finditer(text), None]:
        end = len(text) if match is None else match.end()
        sentence = text[begin:end].strip()
        if len(sentence.split()) >= MIN_WORDS:
            number = [line for offset, line in starts if offset <= begin][-1]
            yield Sentence(path, number, sentence)
        begin = end


def split_paragraphs(path: Path, lines: list[tuple[int, str]]) -> Iterator[Sentence]:
    """Yield the sentences of lines in which blank lines and list items begin a new paragraph."""
    paragraph: list[tuple[int, str]] = []
    for number, line in lines:
        if not line.strip() or LIST_ITEM.match(line):
            yield from split_paragraph(path, paragraph)
            paragraph = []
        if line.strip():
            paragraph.append((number, LIST_ITEM.sub("", line)))
    yield from split_paragraph(path, paragraph)


def list_page_sentences(path: Path, text: str) -> list[Sentence]:
    """Return the sentences of a Markdown page, without tables, code, headings and pictures."""
    lines, is_code = [], False
    prose = FIGURES.sub(_blank_lines, text)
    for number, line in enumerate(prose.splitlines(), start=1):
        if line.lstrip().startswith("```"):
            is_code = not is_code
        elif not is_code:
            lines.append((number, "" if NOT_PROSE.match(line) else line))
    return list(split_paragraphs(path, lines))


def list_code_sentences(path: Path, text: str) -> list[Sentence]:
    """Return the sentences of the comments and docstrings of a Python file, those of constants and fields included."""
    groups: list[list[tuple[int, str]]] = []
    for node in ast.walk(ast.parse(text)):
        children = getattr(node, "body", [])
        for child in children if isinstance(children, list) else []:
            is_text = isinstance(child, ast.Expr) and isinstance(child.value, ast.Constant)
            if is_text and isinstance(child.value.value, str):
                prose = LABELS.sub(_blank_lines, child.value.value)
                groups.append(list(enumerate(prose.splitlines(), start=child.lineno)))
    last = -2
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            number, comment = token.start[0], token.string.lstrip("#! ")
            if number == last + 1:
                groups[-1].append((number, comment))
            else:
                groups.append([(number, comment)])
            last = number
    found = [sentence for group in groups for sentence in split_paragraphs(path, group)]
    return sorted(found, key=lambda sentence: sentence.line)


def _blank_lines(match: re.Match[str]) -> str:
    return "\n" * match.group().count("\n")


def draw_sentences(root: Path, seed: int, count: int) -> list[Sentence]:
    """Return half of ``count`` sentences from `src` and half from README.md and docs."""
    code, pages = [], []
    for path in sorted((root / "src").rglob("*.py")):
        code += list_code_sentences(path.relative_to(root), path.read_text())
    for path in [root / "README.md", *sorted((root / "docs").rglob("*.md"))]:
        pages += list_page_sentences(path.relative_to(root), path.read_text())
    draw = random.Random(seed)
    return [*draw.sample(code, min(count // 2, len(code))), *draw.sample(pages, min(count // 2, len(pages)))]


def main() -> None:
    """Print the sentences."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=40)
    chosen = parser.parse_args()
    for sentence in draw_sentences(ROOT, chosen.seed, chosen.count):
        print(sentence)


if __name__ == "__main__":
    main()
