"""What the site needs beside its pages: those made from the code, and a look at what was built.

MkDocs calls these by their names (``hooks`` in mkdocs.yml).
"""

from __future__ import annotations

import functools
import importlib.util
import re
from pathlib import Path
from types import ModuleType
from typing import Any

from mkdocs.exceptions import PluginError  # pyright: ignore[reportMissingImports] - of the docs extra
from mkdocs.structure.files import File, Files  # pyright: ignore[reportMissingImports] - of the docs extra

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


@functools.cache
def _beside(name: str) -> ModuleType:
    """A script of this folder: MkDocs loads hooks as files, of no package."""
    found = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made from the code."""
    try:
        import depthmocap
    except ModuleNotFoundError as error:
        raise PluginError(f"the site is made from the package, which cannot be imported: {error}") from None
    reference = _beside("reference")
    files.append(File.generated(config, "reference/python.md", content=reference.python_page(depthmocap)))
    files.append(File.generated(config, "reference/commands.md", content=reference.commands_page()))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> None:
    """Refuse a page that names a command, an option, a name or a file which is not there."""
    checks, reference = _beside("checks"), _beside("reference")
    wrong = [
        *checks.wrong_commands(markdown, reference.command_words(), reference.help_of),
        *checks.wrong_names(markdown),
        *checks.wrong_files(markdown, Path(page.file.abs_src_path or ".").parent),
    ]
    if wrong and not page.file.generated_by:
        raise PluginError(f"{page.file.src_path}: " + "; ".join(wrong))


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Take the roles (``:class:`` and the like) out of docstrings' text, which Markdown does not know."""
    return re.sub(r":(?:class|func|meth|attr|mod|data|exc):(?=<code)", "", html) if page.file.generated_by else html


def on_post_build(config: Any) -> None:
    """Refuse a site that would fetch anything from elsewhere."""
    found = fetched_elsewhere(Path(config["site_dir"]))
    if found:
        raise PluginError("pages must fetch nothing from other machines:\n  " + "\n  ".join(found))
