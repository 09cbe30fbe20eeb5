"""Check the language of docs, messages and docstrings: ``python -m tools.language [-v] [FILE ...]``.

The exit code is 1 beyond a limit. `-v` prints each long sentence.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
LONG_SENTENCE, LONG_MESSAGE, LONG_SUMMARY = 22, 15, 12
"""Words; longer ones are counted, or refused (messages, summaries)."""
MAX_LONG, MAX_MEAN = 0.05, 14.0
"""Fraction of long sentences, and mean length in words, of all docs, all messages or all docstrings."""
AVOIDED = (
    r"(?<!information )criteri(on|a)\b(?! of information)",
    r"numerical (shift|noise)",
    r"loops? of direct feed-through",
    r"guarded search",
    r"secondary optim\w+",
    r"valleys?",
    r"rivals?",
    r"move together",
    r"(cannot|can not) be told apart|told apart",
    r"(not|hardly) determined",
    r"determined in effect",
    r"left open|leaves? open",
    r"misfits?",
    r"barycent(re|er)",
    r"slow noise",
    r"what the model (lacks|owes)",
    r"how sure that is",
    r"suspects?",
    r"drop-?outs?",
    r"has to do with|have to do with",
    r"\w*colou?r of (the )?noise|colours?|coloured",
    r"behaviours?|neighbour\w*|centres?|analys(e|es|ed|ing)(?! of)\b",
    r"(linear|summar|normal|initial|optim|regular|factor|vector|real|recogn|minim|maxim|serial|parametr)is(e|es|ed|ing|ation)",
)
"""Terms of the column "do not use" that have one meaning only, and British spelling."""
_AVOIDED = re.compile(r"(?<!\")\b(" + "|".join(AVOIDED) + r")\b", re.IGNORECASE)
_ABBREVIATIONS = re.compile(
    r"\b(e\.g|i\.e|cf|vs|eq|eqs|fig|figs|sec|no|al|approx|resp|etc|(?-i:[A-Z]))\.(?=[\s\-,)])", re.IGNORECASE
)
_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
_END = re.compile(r"(?<=[.!?])[\"')*_]*\s+(?=[\"'(*_`→]*[A-Z0-9`…])")


class Text(NamedTuple):
    """A text in a line of a file."""

    file: Path
    line: int
    words: str


def sentences(text: str) -> Iterator[list[str]]:
    """Yield the words of each sentence of at least three."""
    for sentence in _END.split(_ABBREVIATIONS.sub(r"\1", text)):
        words = [word for word in sentence.split() if re.search(r"\w", word)]
        if len(words) >= 3:
            yield words


def prose(path: Path) -> Iterator[Text]:
    """Yield paragraphs, list items and table cells of a Markdown file; not code, headings and formulas."""
    text = re.sub(r"<!--.*?-->", _lines, path.read_text(encoding="utf-8"), flags=re.DOTALL)
    text = re.sub(r"^( *)(```|~~~).*?^ *\2[^\n]*$", _lines, text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"\$\$.*?\$\$", _lines, text, flags=re.DOTALL)
    block, first = list[str](), 0
    for number, line in enumerate([*text.splitlines(), ""], 1):
        cells = line.strip().startswith("|")
        begins = re.match(r"\s*([-*+]|\d+\.) ", line)
        if not line.strip() or cells or begins or line.startswith(("#", "    ")):
            if block:
                yield Text(path, first, _plain(" ".join(block)))
            block = []
        if cells:
            yield from (Text(path, number, _plain(cell)) for cell in re.split(r"(?<!\\)\|", line) if cell.strip("-: "))
        elif line.strip() and not line.startswith(("#", "    ")):
            first = first if block else number
            block.append(re.sub(r"^\s*([-*+>]|\d+\.) ", "", line))


def _lines(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n")


def _plain(text: str) -> str:
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)|<[^>]+>", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"`[^`]*`|\$[^$]+\$", "CODE", text).strip()


class Code(NamedTuple):
    """Texts of a Python file; docstrings of attributes have no summary."""

    docstrings: list[Text]
    summaries: list[Text]
    messages: list[Text]
    results: list[Text]  # of `Message` classes


def code(path: Path) -> Code:
    """Return the texts of a Python file."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docs = {id(text): text for node in ast.walk(tree) for text in _strings_alone(node)}
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    said, short = [], []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in docs and id(node) not in inside:
            text = Text(path, node.lineno, " ".join(_words(node).split()))
            if len(re.findall(r"[A-Za-z]{2,}", text.words)) >= 4 and not re.search(
                r"[;{}]\s*\w+:|\(\?|==|<\w+", text.words
            ):
                said.append(text)
        if isinstance(node, ast.ClassDef) and any(
            isinstance(base, ast.Name) and base.id == "Message" for base in node.bases
        ):
            short += [Text(path, one.lineno, _words(one)) for one in _messages(node)]
    docstrings = [Text(path, each.lineno, str(each.value)) for each in docs.values()]
    first = {node.body[0].lineno for node in ast.walk(tree) if isinstance(node, _DOCUMENTED) and node.body}
    summaries = [Text(path, line, _summary(words)) for _, line, words in docstrings if line in first]
    return Code(docstrings, summaries, said, short)


def _summary(docstring: str) -> str:
    return re.split(r"\n\s*\n|[.;:] ", docstring.strip())[0]


def _strings_alone(node: ast.AST) -> Iterator[ast.Constant]:
    for each in getattr(node, "body", None) or () if not isinstance(node, ast.Lambda | ast.IfExp) else ():
        if isinstance(each, ast.Expr) and isinstance(each.value, ast.Constant) and isinstance(each.value.value, str):
            yield each.value


def _messages(node: ast.ClassDef) -> Iterator[ast.expr]:
    for each in node.body:
        if isinstance(each, ast.Assign):
            value = each.value
            parts = value.elts if isinstance(value, ast.Tuple) else value.args if isinstance(value, ast.Call) else []
            yield parts[0] if parts else value


def _words(node: ast.expr) -> str:
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "X" for part in node.values)
    text = node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""
    return re.sub(r"\{[^{}]*\}", "X", text)


def docstring_prose(text: Text) -> Iterator[Text]:
    """Yield the paragraphs of a docstring without headings, names of parameters, and code."""
    for block in re.split(r"\n\s*\n", re.sub(r"``[^`]*``|`[^`]*`|:math:`[^`]*`", "CODE", text.words)):
        lines = [line for line in block.splitlines() if not re.match(r"\s*(>>>|\.\.\.? |-+$|[\w, *]+ : )", line)]
        if lines and not re.search(r"^\s*-{3,}\s*$", block, re.MULTILINE):
            yield Text(text.file, text.line, " ".join(lines))


def check(texts: list[Text], what: str, verbose: bool) -> list[str]:
    """Print the figures of texts; return what is beyond a limit."""
    found = [(text, words) for text in texts for words in sentences(text.words)]
    if not found:
        return []
    long = [(text, words) for text, words in found if len(words) > LONG_SENTENCE]
    mean, fraction = sum(len(words) for _, words in found) / len(found), len(long) / len(found)
    print(f"{what:12} {len(found):6} sentences, mean {mean:4.1f} words, {100 * fraction:4.1f} % over {LONG_SENTENCE}")
    if verbose:
        for text, words in long:
            print(f"  {_place(text)}: {len(words)}: {' '.join(words)}")
    bad = [f"{what}: {100 * fraction:.1f} % of sentences over {LONG_SENTENCE} words"] if fraction > MAX_LONG else []
    bad += [f"{what}: mean sentence of {mean:.1f} words"] if mean > MAX_MEAN else []
    return bad + [
        f"{_place(text)}: avoided term {each[0]!r}" for text in texts for each in _AVOIDED.finditer(text.words)
    ]


def _place(text: Text) -> str:
    return f"{text.file.relative_to(ROOT) if text.file.is_relative_to(ROOT) else text.file}:{text.line}"


def too_long(texts: list[Text], limit: int, what: str) -> list[str]:
    """Return the texts with more words than the limit."""
    counts = [(text, len([word for word in text.words.split() if re.search(r"\w", word)])) for text in texts]
    return [f"{_place(text)}: {what} of {count} words: {text.words}" for text, count in counts if count > limit]


def files(names: list[str]) -> list[Path]:
    """Return the files under names; without names, all of the project."""
    where = [Path(name).resolve() for name in names] or [
        ROOT / each for each in ("fmuid", "docs", "experiments", "fmus")
    ]
    where += [] if names else [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md"]
    found = [path for each in where for path in ([each] if each.is_file() else sorted(each.rglob("*")))]
    return [path for path in found if path.suffix in (".md", ".py") and ".venv" not in path.parts]


def main(arguments: list[str]) -> int:
    """Check files; return the exit code."""
    verbose = "-v" in arguments
    paths = files([each for each in arguments if each != "-v"])
    docs = [text for path in paths if path.suffix == ".md" for text in prose(path)]
    parts = [code(path) for path in paths if path.suffix == ".py" and path.is_relative_to(ROOT / "fmuid")]
    bad = check(docs, "docs", verbose)
    bad += check([text for each in parts for text in each.messages], "messages", verbose)
    bad += check(
        [text for each in parts for one in each.docstrings for text in docstring_prose(one)], "docstrings", verbose
    )
    bad += too_long([text for each in parts for text in each.summaries], LONG_SUMMARY, "docstring summary")
    bad += too_long([text for each in parts for text in each.results], LONG_MESSAGE, "message")
    print(*bad, sep="\n")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
