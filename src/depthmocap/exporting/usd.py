"""OpenUSD: skinned bodies and their animation by UsdSkel; metres, Y up, facing +Z at rest. Needs usd-core (extra:
export)."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from depthmocap.core.output import atomic_write
from depthmocap.core.version import __version__
from depthmocap.errors import missing_extra
from depthmocap.exporting.animated_people import AnimatedPerson, animated_people, take_notes
from depthmocap.exporting.bone_rotations import quaternions
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings


def _pxr(*names: str) -> list[Any]:
    """Modules of usd-core, whose stubs do not tell their classes.

    Raises:
        InputError: when it is not installed.
    """
    try:
        return [importlib.import_module(f"pxr.{name}") for name in names]
    except ImportError:
        raise missing_extra("usd-core", "export") from None


def write_usd(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write everybody of a take, each a skinned body of their own bone lengths. A time code is a frame, the first 0.

    A person who is not there yet, or not any more, is invisible; the bones of joints that nobody saw keep their last
    rotation, which ``customData`` of the person tells.

    Raises:
        InputError: when usd-core is not installed, the file cannot be written, or nobody has a sure joint.
    """
    Sdf, Usd, UsdGeom = _pxr("Sdf", "Usd", "UsdGeom")
    people, frames = animated_people(take, settings)
    stage: Any = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(1 / frames.frame_s)
    stage.SetFramesPerSecond(1 / frames.frame_s)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(frames.count - 1)
    world = UsdGeom.Xform.Define(stage, "/take")
    stage.SetDefaultPrim(world.GetPrim())
    notes = take_notes(take, frames)
    for key in ("start_s", "first_timestamp_ns"):
        world.GetPrim().SetCustomDataByKey(key, notes[key])
    world.GetPrim().SetCustomDataByKey("made_by", f"depthmocap {__version__}")
    for i, marker in enumerate(notes["markers"]):
        for key, value in marker.items():
            world.GetPrim().SetCustomDataByKey(f"markers:{i}:{key}", value)
    for person in people:
        _add_person(stage, Sdf.Path("/take").AppendChild(_identifier(person.name)), person)
    layer = stage.GetRootLayer()
    with atomic_write(path) as unfinished:
        layer.Export(str(unfinished))


def _identifier(name: str) -> str:
    """A name as USD takes it: letters, digits and "_", without a digit in front."""
    (Tf,) = _pxr("Tf")

    return Tf.MakeValidIdentifier(name)


def _add_person(stage: Any, path: Any, person: AnimatedPerson) -> None:
    Gf, UsdGeom, UsdSkel, Vt = _pxr("Gf", "UsdGeom", "UsdSkel", "Vt")

    skeleton = person.skeleton
    root = UsdSkel.Root.Define(stage, path)
    root.GetPrim().SetCustomDataByKey("name", person.name)
    for key, by_joint in person.notes().items():
        for joint, ranges in by_joint.items():
            root.GetPrim().SetCustomDataByKey(f"{key}:{joint}", str(ranges))
    if not person.present.all():
        visibility = root.CreateVisibilityAttr()
        for frame in [0, *(np.flatnonzero(np.diff(person.present.astype(int))) + 1).tolist()]:
            shown = UsdGeom.Tokens.inherited if person.present[frame] else UsdGeom.Tokens.invisible
            visibility.Set(shown, frame)

    joints: list[str] = []
    for bone in skeleton.bones:
        name = _identifier(bone.name)
        joints.append(f"{joints[bone.parent]}/{name}" if bone.parent >= 0 else name)
    skel = UsdSkel.Skeleton.Define(stage, path.AppendChild(f"{path.name}_skeleton"))
    skel.CreateJointsAttr(joints)
    skel.CreateJointNamesAttr([bone.name for bone in skeleton.bones])
    skel.CreateBindTransformsAttr(_translations(skeleton.rest_positions))
    skel.CreateRestTransformsAttr(_translations(skeleton.offsets))

    animation = UsdSkel.Animation.Define(stage, path.AppendChild(f"{path.name}_animation"))
    animation.CreateJointsAttr(joints)
    translations = np.tile(skeleton.offsets, (len(skeleton.root), 1, 1))
    translations[:, skeleton.hips] = skeleton.root
    rotations = quaternions(skeleton.local)[..., [3, 0, 1, 2]]  # w first
    animation.CreateScalesAttr(Vt.Vec3hArray(len(joints), Gf.Vec3h(1, 1, 1)))
    translation, rotation = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    for frame in range(len(rotations)):
        translation.Set(_vectors(translations[frame]), frame)
        turns = [Gf.Quatf(w, x, y, z) for w, x, y, z in rotations[frame].tolist()]
        rotation.Set(Vt.QuatfArray(turns), frame)
    UsdSkel.BindingAPI.Apply(skel.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])

    _add_mesh(stage, path, person, skel)


def _add_mesh(stage: Any, path: Any, person: AnimatedPerson, skel: Any) -> None:
    Gf, UsdGeom, UsdSkel, Vt = _pxr("Gf", "UsdGeom", "UsdSkel", "Vt")

    surface = person.surface
    mesh = UsdGeom.Mesh.Define(stage, path.AppendChild(f"{path.name}_body"))
    points = person.vertices_at_rest
    mesh.CreatePointsAttr(_vectors(points))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(surface.faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(surface.faces.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(_vectors(surface.normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateExtentAttr(_vectors(np.stack([points.min(0), points.max(0)])))
    mesh.CreateDisplayColorAttr([Gf.Vec3f(*person.colour)])
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    bones = person.skeleton.bone_of_joint[surface.joints].astype(np.int32)
    binding.CreateJointIndicesPrimvar(False, 4).Set(Vt.IntArray.FromNumpy(bones.ravel()))
    weights = (surface.weights / np.float32(255)).astype(np.float32)
    binding.CreateJointWeightsPrimvar(False, 4).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    binding.CreateSkeletonRel().SetTargets([skel.GetPath()])


def _vectors(values: ndarray) -> Any:
    (Vt,) = _pxr("Vt")

    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, dtype=np.float32))


def _translations(offsets: ndarray) -> Any:
    Gf, Vt = _pxr("Gf", "Vt")

    return Vt.Matrix4dArray([Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*row)) for row in offsets.tolist()])
