"""What tests of viewers share: a small take with its recording, and a page of it."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from viewed import write_recording, write_result

if TYPE_CHECKING:
    from depthmocap.viewing.viewer_page import Page

#: Without viser none of them runs.
collect_ignore_glob = [] if importlib.util.find_spec("viser") else ["test_*.py"]


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first sets of the packaged recording."""
    path = tmp_path_factory.mktemp("viewed") / "take<b>1</b>"
    write_recording(path)
    return path


@pytest.fixture
def result(recording: Path, tmp_path: Path) -> Path:
    """A folder of results of the recording, which the test may change."""
    write_result(tmp_path / "out", recording)
    return tmp_path / "out"


@pytest.fixture(scope="module")
def page() -> Iterator[Page]:
    """A page that is served on this machine alone."""
    from depthmocap.viewing.viewer_page import Page

    with Page("127.0.0.1", 0, "depthmocap") as served:
        yield served
