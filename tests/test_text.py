"""Words that messages are made of."""

from fmuid.formatting import listed, two_digits


def test_words_in_a_list() -> None:
    assert [listed(list(words)) for words in ("a", "ab", "abc")] == ["a", "a and b", "a, b and c"]


def test_two_digits_without_exponents() -> None:
    values = (0.0, 0.0123, 1.84, 99.4, 99.6, -180.4, 7.1e7, float("inf"))
    assert [two_digits(each) for each in values] == ["0", "0.012", "1.8", "99", "100", "-180", "7.1e+07", "inf"]
