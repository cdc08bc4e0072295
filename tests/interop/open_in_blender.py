"""Opens a file in Blender's module and tells where bones are: ``python open_in_blender.py FILE RATE SECONDS...``.

Runs by a Python with bpy, which needs none of this project. The answer is a line of JSON: at each time, of each bone by
name its head in the world (metres, Blender's Z up) then and at rest, and the bounds of every mesh.
"""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path
from typing import Any

bpy: Any = importlib.import_module("bpy")  # which only this program's own Python has


def open_file(path: Path) -> None:
    """Import a file with the importer's own settings, into an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if path.suffix == ".glb":
        bpy.ops.import_scene.gltf(filepath=str(path))
    elif path.suffix == ".fbx":
        bpy.ops.import_scene.fbx(filepath=str(path), anim_offset=0.0)
    elif path.suffix == ".bvh":
        bpy.ops.import_anim.bvh(filepath=str(path), update_scene_fps=True, update_scene_duration=True)
    elif path.suffix == ".usd":
        bpy.ops.wm.usd_import(filepath=str(path))
    else:
        raise ValueError(f"no importer for {path}")


def look(path: Path, seconds: float, frames_per_second: float) -> dict[str, Any]:
    """Where everything is so long after the file's first frame, which importers put at frame 0, and of BVH at 1. That
    of USD takes frames as they are, and that of FBX counts them by the rounded rate; the others set Blender's rate, or
    follow it."""
    scene = bpy.context.scene
    if path.suffix != ".usd":
        frames_per_second = scene.render.fps / (1.0 if path.suffix == ".fbx" else scene.render.fps_base)
    at = seconds * frames_per_second + (path.suffix == ".bvh")
    scene.frame_set(int(at // 1), subframe=at % 1)
    graph = bpy.context.evaluated_depsgraph_get()
    bones, meshes = {}, {}
    for thing in scene.objects:
        if thing.type == "ARMATURE":
            world = thing.matrix_world
            bones[thing.name] = {
                "bones": {bone.name: list(world @ bone.head) for bone in thing.pose.bones},
                "rest": {bone.name: list(world @ bone.head_local) for bone in thing.data.bones},
                "shown": thing.visible_get(),
            }
        elif thing.type == "MESH" and not thing.name.startswith("Icosphere"):  # Blender's own picture of a bone
            shown = thing.evaluated_get(graph)
            corners = [thing.matrix_world @ vertex.co for vertex in shown.to_mesh().vertices]
            meshes[thing.name] = [[min(c[i] for c in corners), max(c[i] for c in corners)] for i in range(3)]
            shown.to_mesh_clear()
    return {"armatures": bones, "meshes": meshes}


def main(path: Path, frames_per_second: float, seconds: list[float]) -> None:
    open_file(path)
    looks = [look(path, each, frames_per_second) for each in seconds]
    print("ANSWER " + json.dumps({"version": bpy.app.version_string, "looks": looks}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]), [float(each) for each in sys.argv[3:]])
