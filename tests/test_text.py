"""Words that messages are made of."""

from fmuid.text import listed


def test_words_in_a_list() -> None:
    assert [listed(list(words)) for words in ("a", "ab", "abc")] == ["a", "a and b", "a, b and c"]
