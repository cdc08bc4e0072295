"""FBX by way of GLB and Blender's module (extra: blender): skinned bodies and their animation; metres."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from depthmocap.core.output import atomic_write
from depthmocap.errors import InputError, missing_extra
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.glb import glb_bytes
from depthmocap.exporting.timeline import frame_times

#: Names a Python that has Blender's module, where this one has not.
BLENDER_PYTHON = "DEPTHMOCAP_BLENDER_PYTHON"
_PROGRAM = Path(__file__).with_name("fbx_in_blender.py")
#: Blender takes so long for the longest of takes at most (s).
_LONGEST_S = 3600


def write_fbx(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write everybody of a take as :func:`~depthmocap.exporting.glb.write_glb` does, and let Blender make FBX of it, in
    a process of its own. Who is not there yet, or not any more, stands as in their first or last pose.

    Raises:
        InputError: when Blender's module is not there or fails, or the file cannot be written.
    """
    elsewhere = os.environ.get(BLENDER_PYTHON)
    python = elsewhere or sys.executable
    if not elsewhere and importlib.util.find_spec("bpy") is None:
        raise missing_extra("bpy", "blender")
    frames = frame_times([take.rows(person, settings.least_confidence) for person in take.people])
    with tempfile.TemporaryDirectory() as name:
        glb, fbx = Path(name) / "pose.glb", Path(name) / "pose.fbx"
        # A size of 0 has no rest pose in FBX.
        glb.write_bytes(glb_bytes(take, settings, vanishing=False))
        command = [python, str(_PROGRAM), str(glb), str(fbx), repr(1 / frames.frame_s), str(frames.count)]
        try:
            done = subprocess.run(
                command, capture_output=True, encoding="utf-8", errors="replace", timeout=_LONGEST_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise InputError(f"Blender's module cannot be run by {python}: {error}") from None
        if done.returncode or not fbx.is_file():
            lines = (done.stderr or done.stdout).strip().splitlines() or ["it said nothing"]
            raise InputError(f"no {path.name}: Blender's module ({python}) failed: {lines[-1]}")
        with atomic_write(path) as unfinished:
            unfinished.write_bytes(fbx.read_bytes())
