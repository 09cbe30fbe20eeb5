"""Encodings of text files, found in their first bytes."""

from __future__ import annotations

import codecs
import re
from collections.abc import Iterator
from contextlib import suppress

_HIGH = re.compile(rb"[\x80-\xff]+")
_SHIFTED = re.compile(r"[\u3000-\u30ff\u3400-\u9fff\uff00-\uff5e×÷°±→Ω℃　\s]+")
_COMMON = frozenset("时间日期年月电压流温度转速序号")
"""Characters of Chinese headers and dates, which Russian words hardly have by chance."""
_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def encodings_of(start: bytes) -> Iterator[str]:
    """Yield the possible encodings of first bytes, the most likely first."""
    marked = next((name for mark, name in _MARKS.items() if start.startswith(mark)), None)
    if marked != "utf-8-sig" and marked is not None:
        yield marked
        return
    if marked is None and (wide := _without_mark(start)):
        yield wide
        return
    yield "utf-8-sig"
    yield from _asian(start)
    yield "cp1252"


def decoded(start: bytes, *, whole: bool) -> Iterator[tuple[str, str]]:
    """Yield each possible encoding of first bytes, and their text."""
    for encoding in encodings_of(start):
        with suppress(UnicodeDecodeError):
            yield encoding, codecs.getincrementaldecoder(encoding)().decode(start, final=whole)


def _without_mark(start: bytes) -> str:
    """Return UTF-16 with the order of bytes whose zeros show it; empty if none."""
    even, odd = start[:2000:2], start[1:2000:2]
    if len(odd) < 4 or start.startswith(b"\0\0"):
        return ""
    zeros = even.count(0) / len(even), odd.count(0) / len(odd)
    if min(zeros) > 0.02 or max(zeros) < 0.7:
        return ""
    return "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"


def _asian(start: bytes) -> Iterator[str]:
    """Yield encodings whose runs of high bytes are no Western words."""
    runs = _HIGH.findall(start)
    longest = max(map(len, runs), default=0)
    high = b"".join(runs)
    with suppress(UnicodeDecodeError):
        text = codecs.getincrementaldecoder("gb18030")().decode(start, final=False)
        if len(_COMMON.intersection(text)) > 1 and _is_chinese(runs, "".join(each for each in text if ord(each) > 127)):
            yield "gb18030"
            return
    if longest >= 3 and sum(each >= 0xC0 or each in (0xA8, 0xB8) for each in high) > 0.9 * len(high):
        yield "cp1251"
        return
    for encoding, likely in (("cp932", _is_japanese), ("gb18030", _is_chinese)):
        with suppress(UnicodeDecodeError):
            text = codecs.getincrementaldecoder(encoding)().decode(start, final=False)
            if longest and likely(runs, "".join(each for each in text if ord(each) > 127)):
                yield encoding


def _is_japanese(runs: list[bytes], text: str) -> bool:
    leads = sum(0x81 <= each[0] <= 0x9F for each in runs)
    return 2 * leads > len(runs) and _SHIFTED.fullmatch(text) is not None


def _is_chinese(runs: list[bytes], text: str) -> bool:
    pairs = all(len(each) % 2 == 0 for each in runs) and max(map(len, runs)) >= 4
    return pairs and _SHIFTED.fullmatch(text) is not None and all(_in_gb2312(each) for each in text)


def _in_gb2312(text: str) -> bool:
    with suppress(UnicodeEncodeError):
        return bool(text.encode("gb2312"))
    return False
