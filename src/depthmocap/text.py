"""Makes text from outside (names, paths, messages of files and SDKs) safe to show: one line of limited length."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence

#: Invisible joiners within words of some scripts, which are harmless.
_JOINERS = "\u200c\u200d"
#: Quoted parts of a message: in quotes, in brackets, or a long word such as a path.
_QUOTED = re.compile(r"'[^']{40,}'|\"[^\"]{40,}\"|\[[^\[\]]{40,}\]|\([^()]{40,}\)|[^\s'\"()\[\]]{40,}")
#: Smallest number of characters to which a quoted part is cut.
_LEFT = 24


def is_visible(letter: str) -> bool:
    """Whether a character is visible when it is printed, or is a space."""
    return letter.isprintable() or letter in _JOINERS or unicodedata.category(letter) == "Zs"


def harmless(text: str) -> str:
    """The text on one line. Unprintable characters (escape sequences, line breaks, direction marks, bytes of a path
    that are no UTF-8) are escaped as in Python: ``\\x1b``."""
    if text.isprintable():
        return text
    return "".join(c if is_visible(c) else c.encode("unicode_escape").decode() for c in text)


def shortened(text: str, most: int) -> str:
    """The text with at most ``most`` characters. The longest quoted parts are cut first, in their middle, so that the
    explanation and the fix stay readable."""
    while (over := len(text) - most) > 0:
        start, end = max((match.span() for match in _QUOTED.finditer(text)), key=lambda s: s[1] - s[0], default=(0, 0))
        if end == start:
            return _middle_cut(text, most)
        text = text[:start] + _middle_cut(text[start:end], max(end - start - over, _LEFT)) + text[end:]
    return text


def _middle_cut(text: str, most: int) -> str:
    tail = (most - 1) // 2
    return f"{text[: most - 1 - tail]}…{text[len(text) - tail :]}"


def camera_list(names: Sequence[str]) -> str:
    """``camera 'a'``, or ``cameras 'a', 'b' and 'c'``."""
    *first, last = map(repr, names)
    return f"cameras {', '.join(first)} and {last}" if first else f"camera {last}"


def offset_lines(offsets_s: Mapping[str, float]) -> list[str]:
    """A line for the user on the time offsets that are added to cameras' timestamps; none without any."""
    offsets = [f"{name!r} {1e3 * offset_s:+.1f} ms" for name, offset_s in offsets_s.items() if offset_s]
    return [f"time offsets of the rig, added to timestamps: {', '.join(offsets)}"] if offsets else []


def joined(lines: Iterable[str], most: int = 2) -> str:
    """The first distinct lines as one sentence, and the number of the others."""
    distinct = list(dict.fromkeys(line.rstrip(".") for line in lines))
    more = [f"and {len(distinct) - most} more"] if len(distinct) > most else []
    return "; ".join([*distinct[:most], *more])
