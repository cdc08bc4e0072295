"""glTF 2.0 in one binary file (GLB): skinned bodies and their animation; metres, Y up, facing +Z at rest."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from depthmocap.core.output import write_file
from depthmocap.core.version import __version__
from depthmocap.exporting.animated_people import AnimatedPerson, animated_people, take_notes
from depthmocap.exporting.bone_rotations import quaternions
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings

#: Numbers of the specification: of components of accessors, and of what a buffer view is for.
_COMPONENTS = {np.dtype(np.uint8): 5121, np.dtype(np.uint16): 5123, np.dtype(np.float32): 5126}
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_VERTICES, _TRIANGLES = 34962, 34963
_MAGIC, _JSON, _BIN = 0x46546C67, 0x4E4F534A, 0x004E4942


class _Document:
    """The two parts of the file, as they grow."""

    def __init__(self) -> None:
        self.json: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": f"depthmocap {__version__}"},
            "scene": 0,
            "scenes": [{"nodes": []}],
        }
        self._binary = bytearray()

    def add(self, key: str, entry: dict[str, Any]) -> int:
        """Append an entry to a list of the document; returns its number."""
        self.json.setdefault(key, []).append(entry)
        return len(self.json[key]) - 1

    def add_array(
        self, array: ndarray, target: int | None = None, bounds: bool = False, normalized: bool = False
    ) -> int:
        """Append an accessor of rows, single precision where they are floats; returns its number."""
        array = array.astype(np.float32) if array.dtype.kind == "f" else array
        rows = array.reshape(len(array), -1)
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self._binary), "byteLength": array.nbytes}
        self._binary += array.tobytes()
        self._binary += bytes(-len(self._binary) % 4)
        accessor: dict[str, Any] = {
            "bufferView": self.add("bufferViews", view | ({"target": target} if target else {})),
            "componentType": _COMPONENTS[array.dtype],
            "count": len(rows),
            "type": _TYPES[rows.shape[1]],
        }
        if bounds:
            accessor |= {"min": rows.min(0).tolist(), "max": rows.max(0).tolist()}
        return self.add("accessors", accessor | ({"normalized": True} if normalized else {}))

    def bytes(self) -> bytes:
        """The file."""
        self.json["buffers"] = [{"byteLength": len(self._binary)}]
        text = json.dumps(self.json, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + len(self._binary)
        return b"".join(
            [
                struct.pack("<III", _MAGIC, 2, length),
                struct.pack("<II", len(text), _JSON),
                text,
                struct.pack("<II", len(self._binary), _BIN),
                self._binary,
            ]
        )


def write_glb(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write everybody of a take, each a skinned body of their own bone lengths, and one animation of all.

    Frames are evenly spaced from the first pose on, at time 0. A person who is not there yet, or not any more, has no
    size; the bones of joints that nobody saw keep their last rotation, which the person's ``extras`` tell.

    Raises:
        InputError: when the file cannot be written, or nobody has a sure joint.
    """
    write_file(path, glb_bytes(take, settings))


def glb_bytes(take: ExportedTake, settings: FileSettings, vanishing: bool = True) -> bytes:
    """The file's content.

    Args:
        vanishing: whoever is not there has no size; otherwise they stand as in their first or last pose.
    """
    people, frames = animated_people(take, settings)
    document = _Document()
    document.json["scenes"][0]["extras"] = take_notes(take, frames)
    times = document.add_array((np.arange(frames.count) * frames.frame_s)[:, None], bounds=True)
    animation: dict[str, Any] = {"name": "take", "channels": [], "samplers": []}
    for person in people:
        nodes = _add_person(document, person)
        _animate(document, animation, person, nodes, times, vanishing)
    document.add("animations", animation)
    return document.bytes()


def _add_person(document: _Document, person: AnimatedPerson) -> list[int]:
    """Add a person at rest; returns the nodes of the bones, and last that of the person."""
    skeleton, surface = person.skeleton, person.surface
    nodes = []
    for bone, offset in zip(skeleton.bones, skeleton.offsets, strict=True):
        node = document.add("nodes", {"name": bone.name, "translation": offset.tolist()})
        if bone.parent >= 0:
            document.json["nodes"][nodes[bone.parent]].setdefault("children", []).append(node)
        nodes.append(node)
    matrices = np.tile(np.eye(4), (len(nodes), 1, 1))
    matrices[:, :3, 3] = -skeleton.rest_positions
    skin = document.add(
        "skins",
        {
            "name": person.name,
            "joints": list(nodes),
            "skeleton": nodes[0],
            "inverseBindMatrices": document.add_array(np.swapaxes(matrices, 1, 2)),  # columns first
        },
    )
    material = {
        "name": person.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [*person.colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.8,
        },
    }  # fmt: skip
    bone_of = skeleton.bone_of_joint.astype(np.uint8)
    unused = surface.weights == 0
    attributes = {
        "POSITION": document.add_array(person.vertices_at_rest, _VERTICES, bounds=True),
        "NORMAL": document.add_array(surface.normals, _VERTICES),
        "JOINTS_0": document.add_array(np.where(unused, 0, bone_of[surface.joints]).astype(np.uint8), _VERTICES),
        "WEIGHTS_0": document.add_array(surface.weights, _VERTICES, normalized=True),
    }
    primitive = {
        "attributes": attributes,
        "indices": document.add_array(surface.faces.reshape(-1, 1), _TRIANGLES),
        "material": document.add("materials", material),
    }
    mesh = document.add("meshes", {"name": person.name, "primitives": [primitive]})
    body = document.add("nodes", {"name": f"{person.name}-body", "mesh": mesh, "skin": skin})
    whole = document.add("nodes", {"name": person.name, "children": [nodes[0]], "extras": person.notes()})
    document.json["scenes"][0]["nodes"] += [whole, body]
    return [*nodes, whole]


def _animate(
    document: _Document,
    animation: dict[str, Any],
    person: AnimatedPerson,
    nodes: list[int],
    times: int,
    vanishing: bool,
) -> None:
    def channel(node: int, path: str, values: ndarray, interpolation: str = "LINEAR") -> None:
        animation["samplers"].append(
            {"input": times, "output": document.add_array(values), "interpolation": interpolation}
        )
        target = {"node": node, "path": path}
        animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})

    skeleton = person.skeleton
    rotations = quaternions(skeleton.local)
    channel(nodes[skeleton.hips], "translation", skeleton.root)
    for i in range(len(skeleton.bones)):
        if np.abs(rotations[:, i, 3]).min() < 1 - 1e-9:
            channel(nodes[i], "rotation", rotations[:, i])
    if vanishing and not person.present.all():
        channel(nodes[-1], "scale", np.repeat(person.present[:, None], 3, 1).astype(np.float32), "STEP")
