"""A full-body model for OpenSim, made for a person from the lengths of their bones.

The model is our own: fifteen rigid bodies and their joints in the conventions of OpenSim's gait models (X forward, Y
up, Z to the right; names of coordinates as theirs), no muscles, markers at the joints that depthmocap finds, under
their names, so that ``pose.trc`` is read as it is. Joints turn in the sequences that the International Society of
Biomechanics recommends: flexion, ab- or adduction, rotation; the pelvis rotation, list, tilt, whichever way the person
faces.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree as Xml

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARKS
from depthmocap.body.skeleton import JOINT_INDEX, PARENTS
from depthmocap.core.output import write_file
from depthmocap.exporting.body_motion import solve_body
from depthmocap.exporting.exported_take import ExportedTake
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.landmark_model import LandmarkModel

#: The version of OpenSim's format of models.
_VERSION = "40600"
#: The mass of the model (kg): a take does not tell it. Scale it before anything that depends on forces.
MASS_KG = 70.0
#: Share of the mass of each body, after de Leva 1996 (mean of women and men); of a pair each.
_MASSES = {
    "pelvis": 0.13, "torso": 0.300, "head": 0.068, "femur": 0.1447, "tibia": 0.0457, "foot": 0.0133, "humerus": 0.0263,
    "radius": 0.0150, "hand": 0.0059,
}  # fmt: skip
_X, _Y, _Z = (1, 0, 0), (0, 1, 0), (0, 0, 1)


@dataclasses.dataclass(frozen=True)
class Coordinate:
    """An angle of a joint (degrees), or a place of the pelvis (m). One that joints alone do not show is locked at 0
    unless landmarks are markers too."""

    name: str
    axis: tuple[int, int, int]
    low: int
    high: int
    by_landmarks: bool = False


@dataclasses.dataclass(frozen=True)
class ModelJoint:
    """A body and the joint by which it hangs on its parent.

    Attributes:
        at: the joint of the skeleton at which it turns.
        end: the joint to which it reaches; None of the last ones.
        markers: joints that belong to the body besides.
    """

    body: str
    parent: str
    at: str
    end: str | None
    coordinates: tuple[Coordinate, ...]
    markers: tuple[str, ...] = ()


def _side(letter: str) -> tuple[ModelJoint, ...]:
    low, sign = letter.lower(), 1 if letter == "R" else -1
    across, along = (sign, 0, 0), (0, sign, 0)
    hip = (
        Coordinate(f"hip_flexion_{low}", _Z, -60, 150),
        Coordinate(f"hip_adduction_{low}", across, -90, 60),
        Coordinate(f"hip_rotation_{low}", along, -60, 60),
    )
    arm = (
        Coordinate(f"arm_flex_{low}", _Z, -180, 180),
        Coordinate(f"arm_add_{low}", across, -190, 90),
        Coordinate(f"arm_rot_{low}", along, -120, 120),
    )
    knee = (Coordinate(f"knee_angle_{low}", (0, 0, -1), -10, 170),)
    elbow = (Coordinate(f"elbow_flex_{low}", _Z, -10, 170), Coordinate(f"pro_sup_{low}", along, -90, 90, True))
    return (
        ModelJoint(f"femur_{low}", "pelvis", f"{letter}Hip", f"{letter}Knee", hip),
        ModelJoint(f"tibia_{low}", f"femur_{low}", f"{letter}Knee", f"{letter}Foot", knee),
        ModelJoint(f"foot_{low}", f"tibia_{low}", f"{letter}Foot", None,
                   (Coordinate(f"ankle_angle_{low}", _Z, -60, 40, True),)),
        ModelJoint(f"humerus_{low}", "torso", f"{letter}Shoulder", f"{letter}Elbow", arm),
        ModelJoint(f"radius_{low}", f"humerus_{low}", f"{letter}Elbow", f"{letter}Hand", elbow),
        ModelJoint(f"hand_{low}", f"radius_{low}", f"{letter}Hand", None,
                   (Coordinate(f"wrist_flex_{low}", _Z, -80, 80, True),)),
    )  # fmt: skip


#: All joints, parents before their children; the pelvis turns in the world and has three places besides.
MODEL: tuple[ModelJoint, ...] = (
    ModelJoint("pelvis", "ground", "Hip", None, (
        Coordinate("pelvis_rotation", _Y, -720, 720), Coordinate("pelvis_list", _X, -90, 90),
        Coordinate("pelvis_tilt", _Z, -120, 120),
    )),
    ModelJoint("torso", "pelvis", "Spine", "Neck", (
        Coordinate("lumbar_extension", _Z, -120, 60), Coordinate("lumbar_bending", _X, -60, 60),
        Coordinate("lumbar_rotation", _Y, -90, 90),
    ), ("Spine1", "Spine2")),
    ModelJoint("head", "torso", "Neck", "Head", (
        Coordinate("neck_extension", _Z, -90, 90), Coordinate("neck_bending", _X, -60, 60),
        Coordinate("neck_rotation", _Y, -90, 90, True),
    )),
    *_side("R"),
    *_side("L"),
)  # fmt: skip
PLACES = ("pelvis_tx", "pelvis_ty", "pelvis_tz")
#: Coordinates that a straight limb does not show; the solver holds them near 0 by a little.
UNSURE = tuple(f"{name}_{side}" for side in "rl" for name in ("hip_rotation", "arm_rot"))
#: Every coordinate in the order of ``ik.mot``.
COORDINATES: tuple[str, ...] = (
    *(coordinate.name for coordinate in MODEL[0].coordinates), *PLACES,
    *(coordinate.name for joint in MODEL[1:] for coordinate in joint.coordinates),
)  # fmt: skip


def _position(offsets: Float[ndarray, "18 3"], joint: str, origin: str) -> Float[ndarray, "3"]:
    """A joint seen from another one above it in the skeleton at rest, in OpenSim's axes."""
    total = np.zeros(3)
    name: str | None = joint
    while name != origin:
        assert name is not None, f"{joint} is not below {origin}"
        total += offsets[JOINT_INDEX[name]]
        name = PARENTS[name]
    return np.array([total[2], total[1], -total[0]])


def _hangs(joint: ModelJoint) -> bool:
    return joint.body[:-2] in ("femur", "tibia", "humerus", "radius", "foot", "hand")


def _length(offsets: Float[ndarray, "18 3"], joint: ModelJoint) -> float:
    assert joint.end is not None
    return float(np.linalg.norm(offsets[JOINT_INDEX[joint.end]]))


def _place(offsets: Float[ndarray, "18 3"], joint: ModelJoint) -> Float[ndarray, "3"]:
    """Where a body's joint is on its parent: limbs hang straight down at rest."""
    parent = next(candidate for candidate in MODEL if candidate.body == joint.parent)
    if _hangs(parent):
        return np.array([0.0, -_length(offsets, parent), 0.0])
    return _position(offsets, joint.at, parent.at)


def _markers(offsets: Float[ndarray, "18 3"], joint: ModelJoint) -> dict[str, Float[ndarray, "3"]]:
    """The markers of a body: where its joint is, what belongs to it, and what is at its end where no body goes on."""
    places = {joint.at: np.zeros(3)}
    places |= {name: _position(offsets, name, joint.at) for name in joint.markers}
    if joint.body == "head":
        places["Head"] = _position(offsets, "Head", "Neck")
    return places


def _landmarks(offsets: Float[ndarray, "18 3"], joint: ModelJoint) -> dict[str, Float[ndarray, "3"]]:
    """The surface landmarks of a body."""
    places = {}
    for landmark, offset in zip(LANDMARKS, LandmarkModel.load().offsets_m(offsets), strict=True):
        if _body_of(landmark.bone) != joint.body:
            continue
        # From the body's own joint in the T pose, in OpenSim's axes.
        place = _position(offsets, landmark.joint, joint.at) + np.array([offset[2], offset[1], -offset[0]])
        if joint.body[:-2] in ("humerus", "radius", "hand"):  # an arm that is out to the side comes to hang
            side = 1 if joint.body.endswith("r") else -1
            place = np.array([place[0], -side * place[2], side * place[1]])
        places[landmark.name] = place
    return places


def _body_of(bone: str) -> str:
    """The body that moves with the bone that starts at a joint."""
    if bone == "Head":
        return "head"
    return next(joint.body for joint in MODEL if bone in (joint.at, *joint.markers))


def model_xml(offsets: Float[ndarray, "18 3"], name: str, landmarks: bool = False) -> str:
    """The model of a person as the text of an ``.osim`` file.

    Args:
        offsets: of each joint from its parent at rest (:func:`~depthmocap.exporting.bone_rotations.rest_offsets`).
        landmarks: surface landmarks are markers beside the joints, and no coordinate is locked.
    """
    document = Xml.Element("OpenSimDocument", Version=_VERSION)
    model = Xml.SubElement(document, "Model", name=name)
    _text(model, "credits", "depthmocap; Apache-2.0. Masses are nominal.")
    _text(model, "length_units", "meters")
    _text(model, "force_units", "N")
    _text(model, "gravity", "0 -9.80665 0")
    bodies = Xml.SubElement(Xml.SubElement(model, "BodySet", name="bodyset"), "objects")
    joints = Xml.SubElement(Xml.SubElement(model, "JointSet", name="jointset"), "objects")
    markers = Xml.SubElement(Xml.SubElement(model, "MarkerSet", name="markerset"), "objects")
    for joint in MODEL:
        _body(bodies, joint, offsets)
        _joint(joints, joint, np.zeros(3) if joint.parent == "ground" else _place(offsets, joint), landmarks)
        placed = _markers(offsets, joint) | (_landmarks(offsets, joint) if landmarks else {})
        for marker, location in placed.items():
            element = Xml.SubElement(markers, "Marker", name=marker)
            _text(element, "socket_parent_frame", f"/bodyset/{joint.body}")
            _text(element, "location", _numbers(location))
            _text(element, "fixed", "true")
    Xml.indent(document, " ")
    return '<?xml version="1.0" encoding="UTF-8" ?>\n' + Xml.tostring(document, encoding="unicode") + "\n"


def write_osim(path: Path, take: ExportedTake, settings: FileSettings) -> None:
    """Write the model of a person.

    Raises:
        InputError: when the file cannot be written, or no joint remains.
    """
    (person,) = take.people
    motion = solve_body(take.rows(person, settings.least_confidence), settings.fill_s)
    write_file(path, model_xml(motion.offsets, take.name(person) or "person", settings.landmarks))


def _body(parent: Xml.Element, joint: ModelJoint, offsets: Float[ndarray, "18 3"]) -> None:
    element = Xml.SubElement(parent, "Body", name=joint.body)
    kind = joint.body.removesuffix("_r").removesuffix("_l")
    ends = {"pelvis": (0.0, 0.1, 0.0), "foot": (0.12, -0.04, 0.0), "hand": (0.0, -0.09, 0.0), "head": (0.0, 0.22, 0.0)}
    if kind in ends:
        end = np.array(ends[kind])
    elif _hangs(joint):
        end = np.array([0.0, -_length(offsets, joint), 0.0])
    else:
        end = _position(offsets, str(joint.end), joint.at)
    length = float(np.linalg.norm(end))
    radius = {"torso": 0.11, "pelvis": 0.11, "head": 0.08, "femur": 0.06}.get(kind, 0.035)
    components = Xml.SubElement(element, "components")
    frame = Xml.SubElement(components, "PhysicalOffsetFrame", name=f"{joint.body}_shape")
    shapes = Xml.SubElement(frame, "attached_geometry")
    shape = Xml.SubElement(shapes, "Ellipsoid", name=f"{joint.body}_ellipsoid")
    _text(shape, "socket_frame", "..")
    _text(shape, "radii", _numbers([radius, length / 2, radius]))
    _text(frame, "socket_parent", "..")
    _text(frame, "translation", _numbers(end / 2))
    # The ellipsoid's long axis is y.
    tilt = -float(np.arctan2(end[0], end[1])) if end[1] > 0 else float(np.arctan2(end[0], -end[1]))
    _text(frame, "orientation", _numbers([0.0, 0.0, tilt]))
    mass = MASS_KG * _MASSES[kind]
    moments = mass / 5 * np.array([(length / 2) ** 2 + radius**2, 2 * radius**2, (length / 2) ** 2 + radius**2])
    _text(element, "mass", f"{mass:.6g}")
    _text(element, "mass_center", _numbers(end / 2))
    _text(element, "inertia", _numbers([*moments, 0.0, 0.0, 0.0]))


def _joint(parent: Xml.Element, joint: ModelJoint, place: Float[ndarray, "3"], landmarks: bool) -> None:
    element = Xml.SubElement(parent, "CustomJoint", name=f"{joint.body}_joint")
    above = "/ground" if joint.parent == "ground" else f"/bodyset/{joint.parent}"
    frames = {f"{joint.parent}_offset": (above, place), f"{joint.body}_offset": (f"/bodyset/{joint.body}", np.zeros(3))}
    for role, name in zip(("parent", "child"), frames, strict=True):
        _text(element, f"socket_{role}_frame", name)
    coordinates = Xml.SubElement(element, "coordinates")
    for coordinate in joint.coordinates:
        _coordinate(
            coordinates,
            coordinate.name,
            np.radians([coordinate.low, coordinate.high]),
            coordinate.by_landmarks and not landmarks,
        )
    free = joint.parent == "ground"
    for name in PLACES if free else ():
        _coordinate(coordinates, name, np.array([-1e3, 1e3]), False)
    made = Xml.SubElement(element, "frames")
    for name, (socket, translation) in frames.items():
        frame = Xml.SubElement(made, "PhysicalOffsetFrame", name=name)
        _text(frame, "socket_parent", socket)
        _text(frame, "translation", _numbers(translation))
        _text(frame, "orientation", "0 0 0")
    transform = Xml.SubElement(element, "SpatialTransform")
    axes = [coordinate.axis for coordinate in joint.coordinates]
    # Axes that nothing turns about must be independent of the others.
    axes += [axis for axis in (_X, _Y, _Z) if axis not in [tuple(map(abs, taken)) for taken in axes]]
    for i, axis in enumerate(axes[:3]):
        turned = joint.coordinates[i].name if i < len(joint.coordinates) else None
        _axis(transform, f"rotation{i + 1}", turned, axis)
    for i, axis in enumerate((_X, _Y, _Z)):
        _axis(transform, f"translation{i + 1}", PLACES[i] if free else None, axis)


def _coordinate(parent: Xml.Element, name: str, limits: Float[ndarray, "2"], locked: bool) -> None:
    element = Xml.SubElement(parent, "Coordinate", name=name)
    _text(element, "default_value", "0")
    _text(element, "range", _numbers(limits))
    _text(element, "clamped", "false")
    _text(element, "locked", str(locked).lower())


def _axis(parent: Xml.Element, name: str, coordinate: str | None, axis: Sequence[int]) -> None:
    element = Xml.SubElement(parent, "TransformAxis", name=name)
    _text(element, "coordinates", coordinate or "")
    _text(element, "axis", " ".join(map(str, axis)))
    if coordinate is None:
        _text(Xml.SubElement(element, "Constant", name="function"), "value", "0")
    else:
        _text(Xml.SubElement(element, "LinearFunction", name="function"), "coefficients", "1 0")


def _text(parent: Xml.Element, tag: str, text: str) -> None:
    Xml.SubElement(parent, tag).text = text


def _numbers(values: Sequence[float] | Float[ndarray, " n"]) -> str:
    return " ".join(f"{float(value) + 0.0:.8g}" for value in values)
