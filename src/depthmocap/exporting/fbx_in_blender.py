"""Turns a GLB into FBX by Blender's module: ``python fbx_in_blender.py GLB FBX FRAMES_PER_SECOND FRAMES``.

Runs as a program of its own, by a Python that has ``bpy``, and imports nothing of this package.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

_ASIDE_M = 1e-3


def convert(glb: str, fbx: str, frames_per_second: float, frames: int) -> None:
    """Import at the take's rate, and write every frame of every bone, in metres."""
    bpy: Any = importlib.import_module("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.fps = max(1, round(frames_per_second))
    scene.render.fps_base = scene.render.fps / frames_per_second
    bpy.ops.import_scene.gltf(filepath=glb, disable_bone_shape=True)
    for action in bpy.data.actions:
        _on_whole_frames(action, frames)
    for thing in scene.objects:
        if thing.type == "ARMATURE":
            _move_root(bpy, thing)
    scene.frame_start, scene.frame_end = 0, max(frames - 1, 1)
    bpy.ops.export_scene.fbx(
        filepath=fbx,
        object_types={"EMPTY", "ARMATURE", "MESH"},
        apply_scale_options="FBX_SCALE_UNITS",
        add_leaf_bones=False,
        bake_anim_use_nla_strips=False,
        bake_anim_use_all_actions=False,
        bake_anim_simplify_factor=0.0,
    )


def _on_whole_frames(action: Any, frames: int) -> None:
    """Poses go where frames are, which is what FBX gets: the importer of glTF counts by the rounded rate."""
    bags = [action]  # before Blender 4.4
    if hasattr(action, "layers"):
        bags = [bag for layer in action.layers for strip in layer.strips for bag in strip.channelbags]
    for bag in bags:
        for curve in bag.fcurves:
            keys = curve.keyframe_points
            if len(keys) == frames > 1:
                for i, key in enumerate(keys):
                    key.co.x = i
                curve.update()


def _move_root(bpy: Any, armature: Any) -> None:
    """A bone at the origin goes a little aside: FBX has no tails of bones, and Blender's importer takes a child that is
    straight above it for one that hangs at its tail, and never moves by itself."""
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    for bone in armature.data.edit_bones:
        if bone.parent is None and len(bone.children) == 1:
            bone.head.x += _ASIDE_M
            bone.tail.x += _ASIDE_M
    bpy.ops.object.mode_set(mode="OBJECT")


if __name__ == "__main__":
    convert(sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4]))
