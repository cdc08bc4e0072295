"""Text of others (names, paths, what files and SDKs say) made fit to be shown: one harmless line of bounded length."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence

#: Joiners within words of some scripts, which are not printed and do nothing else.
_JOINERS = "\u200c\u200d"
#: What a message quotes: in quotes, in brackets, or a long word, as paths are.
_QUOTED = re.compile(r"'[^']{40,}'|\"[^\"]{40,}\"|\[[^\[\]]{40,}\]|\([^()]{40,}\)|[^\s'\"()\[\]]{40,}")
#: What is left of something quoted that is cut, at least.
_LEFT = 24


def is_shown(letter: str) -> bool:
    """Whether a letter is seen where it is printed, or is a space."""
    return letter.isprintable() or letter in _JOINERS or unicodedata.category(letter) == "Zs"


def harmless(text: str) -> str:
    """The text on one line. What is not printed (escape sequences, line breaks, marks of direction, bytes of a path
    that are no UTF-8) stands as Python writes it: ``\\x1b``."""
    if text.isprintable():
        return text
    return "".join(c if is_shown(c) else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str, most: int) -> str:
    """The text with so many letters at most. What is quoted in it is cut first, in its middle, the longest before
    others; what is said about it, and what mends it, is left."""
    while (over := len(text) - most) > 0:
        start, end = max((found.span() for found in _QUOTED.finditer(text)), key=lambda s: s[1] - s[0], default=(0, 0))
        if end == start:
            return _middle_cut(text, most)
        text = text[:start] + _middle_cut(text[start:end], max(end - start - over, _LEFT)) + text[end:]
    return text


def _middle_cut(text: str, most: int) -> str:
    tail = (most - 1) // 2
    return f"{text[: most - 1 - tail]}…{text[len(text) - tail :]}"


def cameras(names: Sequence[str]) -> str:
    """``camera 'a'``, or ``cameras 'a', 'b' and 'c'``."""
    *first, last = map(repr, names)
    return f"cameras {', '.join(first)} and {last}" if first else f"camera {last}"


def joined(lines: Iterable[str], most: int = 2) -> str:
    """The first of many lines, each once, as one sentence, and how many more there are."""
    told = list(dict.fromkeys(line.rstrip(".") for line in lines))
    more = [f"and {len(told) - most} more"] if len(told) > most else []
    return "; ".join([*told[:most], *more])
