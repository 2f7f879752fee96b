"""The sentences that are drawn are those of comments, docstrings and prose, with the right line."""

from pathlib import Path

from benchmarks.read_sentences import draw_sentences, list_code_sentences, list_page_sentences

PAGE = """# A heading of five words

A first sentence stands here. A second
one spans two lines, e.g. this one.

<!-- figures:times -->
Figures are left out as well.
<!-- figures:end -->

| a table | is left out here |

- An item is a paragraph.
- Another item is one too.

```python
# This comment is code, not prose.
```
"""
CODE = '''"""Do one thing at a time."""

LIMIT = 3
"""Largest number of tries in one run."""


def run() -> None:
    """Run the program one single time.

    Raises
    ------
    ValueError
        If the program is not there.
    """
    # The comment goes on
    # over two whole lines.
    print("This text is not a comment at all.")
'''


def test_sentences_of_a_page() -> None:
    found = [(each.line, each.text) for each in list_page_sentences(Path("page.md"), PAGE)]
    assert found == [
        (3, "A first sentence stands here."),
        (3, "A second one spans two lines, e.g. this one."),
        (12, "An item is a paragraph."),
        (13, "Another item is one too."),
    ]


def test_sentences_of_code() -> None:
    found = [(each.line, each.text) for each in list_code_sentences(Path("code.py"), CODE)]
    assert found == [
        (1, "Do one thing at a time."),
        (4, "Largest number of tries in one run."),
        (8, "Run the program one single time."),
        (13, "If the program is not there."),
        (15, "The comment goes on over two whole lines."),
    ]


def test_a_seed_draws_the_same_sentences(tmp_path: Path) -> None:
    (tmp_path / "src").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "src" / "code.py").write_text(CODE)
    (tmp_path / "README.md").write_text(PAGE)
    assert draw_sentences(tmp_path, 1, 4) == draw_sentences(tmp_path, 1, 4)
    assert {each.path.suffix for each in draw_sentences(tmp_path, 1, 4)} == {".py", ".md"}
    assert len({str(draw_sentences(tmp_path, seed, 4)) for seed in range(8)}) > 1
