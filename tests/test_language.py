"""The check of the language counts what readers read."""

from pathlib import Path

import pytest

from tools.language import code, main, prose, sentences

PAGE = """# A heading of many words

A sentence of five words. See e.g. [a page](x.md) for `a b c` and
the rest. <!-- a comment
of two lines -->

    code that nobody counts

| head of table | other |
|---|---|
| a cell of words | x |
- an item of list
```toml
code = "of a block"
```
"""


def test_prose_is_counted_without_code(tmp_path: Path) -> None:
    path = tmp_path / "page.md"
    path.write_text(PAGE)
    found = [(text.line, words) for text in prose(path) for words in sentences(text.words)]
    assert [(line, len(words)) for line, words in found] == [(3, 5), (3, 9), (9, 3), (11, 4), (12, 4)]


def test_texts_of_code_are_told_apart(tmp_path: Path) -> None:
    path = tmp_path / "module.py"
    path.write_text(
        '"""A module."""\nx = 1\n"""An attribute."""\n'
        'class M(Message):\n    A = ("{x} of words", "what that is for all")\n'
        'def f():\n    """Return it. More."""\n    raise ValueError(f"{x}: is not a number, give one")\n'
    )
    found = code(path)
    assert [text.words for text in found.summaries] == ["A module.", "Return it"]
    assert [text.words for text in found.results] == ["X of words"]
    assert [text.words for text in found.messages] == ["what that is for all", "X: is not a number, give one"]
    assert len(found.docstrings) == 3


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("The fit is good.", None),
        ("The criterion is low.", "avoided term 'criterion'"),
        ("The information criterion is low.", None),
        ("word " * 23 + "end.", "100.0 % of sentences over 22"),
    ],
)
def test_bad_language_ends_with_code_1(
    text: str, found: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "page.md"
    path.write_text(text)
    assert main([str(path)]) == (found is not None)
    assert (found or "") in capsys.readouterr().out
