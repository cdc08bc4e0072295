"""The formats of files: one row and one function each."""

from __future__ import annotations

import dataclasses
import importlib
import importlib.util
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from depthmocap.errors import missing_extra
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.fbx import BLENDER_PYTHON
from depthmocap.exporting.file_settings import FileSettings, FormatName

#: Writes a file of a take; of one person, where people have files of their own. What it returns of a person goes into
#: export.json.
Write = Callable[[Path, ExportedTake, FileSettings], dict[str, Any] | None]


@dataclasses.dataclass(frozen=True)
class FileFormat:
    """A format of files.

    Attributes:
        module: that writes it, by ``function`` (:data:`Write`).
        together: whether everybody is in one file; otherwise each person has one.
        needs: the module of another package, that package, and the extra that brings it.
        name: of the file; by default "pose" with the format's ending.
        elsewhere: a variable of the environment that may name another Python, which has what is needed.
    """

    module: str
    function: str
    together: bool = False
    needs: tuple[str, str, str] | None = None
    name: str = ""
    elsewhere: str = ""

    @property
    def write(self) -> Write:
        """The function that writes it."""
        return getattr(importlib.import_module(f"depthmocap.exporting.{self.module}"), self.function)


FORMATS: dict[FormatName, FileFormat] = {
    "csv": FileFormat("rotation_csv", "write_rotation_csv"),
    "trc": FileFormat("trc", "write_take_trc"),
    "bvh": FileFormat("bvh", "write_take_bvh"),
    "npz": FileFormat("pose_npz", "write_npz"),
    "osim": FileFormat("opensim_model", "write_osim", name="model.osim"),
    "mot": FileFormat("opensim_ik", "write_mot", needs=("opensim", "opensim", "opensim"), name="ik.mot"),
    "c3d": FileFormat("c3d", "write_c3d", together=True, needs=("ezc3d", "ezc3d", "export")),
    "glb": FileFormat("glb", "write_glb", together=True),
    "usd": FileFormat("usd", "write_usd", together=True, needs=("pxr", "usd-core", "export")),
    "fbx": FileFormat("fbx", "write_fbx", together=True, needs=("bpy", "bpy", "blender"), elsewhere=BLENDER_PYTHON),
}


def check_formats(formats: Sequence[FormatName]) -> None:
    """
    Raises:
        InputError: when a format needs a package that is not installed.
    """
    for name in formats:
        needs, elsewhere = FORMATS[name].needs, FORMATS[name].elsewhere
        if needs is None or (elsewhere and os.environ.get(elsewhere)):
            continue
        if importlib.util.find_spec(needs[0]) is None:
            raise missing_extra(needs[1], needs[2])
