"""What the site needs beside its pages: those made from the code, and a look at what was built.

MkDocs calls these by their names (``hooks`` in mkdocs.yml).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError

#: What a browser would fetch by itself when a page is opened. Links that a reader follows are no part of that.
_FETCHED = re.compile(
    r"<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\bsrc=[\"']?(?:https?:)?//[^\"'\s>]+"
    r"|<link\b(?=[^>]*\brel=[\"']?(?:stylesheet|preconnect|preload|icon|dns-prefetch))[^>]*?\bhref=[\"']?(?:https?:)?//[^\"'\s>]+",
    re.IGNORECASE,
)
_FETCHED_BY_STYLE = re.compile(r"(?:@import\s+(?:url\()?|url\()[\"']?(?:https?:)?//[^\"')\s]+", re.IGNORECASE)


def fetched_elsewhere(site: Path) -> list[str]:
    """What pages and style sheets of a built site would fetch from other machines, one line each."""
    found = []
    for path in sorted(site.rglob("*")):
        pattern = {".html": _FETCHED, ".css": _FETCHED_BY_STYLE}.get(path.suffix)
        if pattern is not None:
            text = path.read_text(encoding="utf-8")
            found += [f"{path.relative_to(site)}: {match[0]}" for match in pattern.finditer(text)]
    return found


def on_post_build(config: Any) -> None:
    """Refuse a site that would fetch anything from elsewhere."""
    found = fetched_elsewhere(Path(config["site_dir"]))
    if found:
        raise PluginError("pages must fetch nothing from other machines:\n  " + "\n  ".join(found))
