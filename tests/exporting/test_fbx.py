"""FBX needs Blender's module; tests/interop opens what it makes."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
from two_people_take import write_take

from depthmocap.errors import InputError
from depthmocap.exporting.export_command import ExportSettings, export
from depthmocap.exporting.fbx import BLENDER_PYTHON
from depthmocap.exporting.file_formats import check_formats


def test_without_blenders_module_the_command_for_it_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    if importlib.util.find_spec("bpy") is not None:
        pytest.skip("it is there")
    monkeypatch.delenv(BLENDER_PYTHON, raising=False)
    with pytest.raises(InputError, match=r"'bpy': pip install 'depthmocap\[blender\]'"):
        check_formats(["fbx"])


def test_what_blender_says_when_it_fails_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_take(tmp_path / "take")
    settings = ExportSettings(tmp_path / "take", tmp_path / "out", formats=("fbx",))
    fake = tmp_path / "python"
    monkeypatch.setenv(BLENDER_PYTHON, str(fake))
    with pytest.raises(InputError, match="cannot be run"):
        export(settings)
    if sys.platform == "win32":
        return
    fake.write_text("#!/bin/sh\necho no GPU, no luck >&2\nexit 1\n")
    fake.chmod(0o755)
    with pytest.raises(InputError, match="no luck"):
        export(settings)
    assert not (tmp_path / "out" / "pose.fbx").exists()
