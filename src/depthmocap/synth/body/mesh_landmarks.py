"""Where surface landmarks are on the engine's mesh: one vertex each, the same on bodies of every shape."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray

from depthmocap.body.landmarks import LANDMARK_NAMES
from depthmocap.geometry.transforms import unit
from depthmocap.synth.body.mesh import Body, BodyModel, Phenotype

_FORWARD, _BACK, _UP = np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
_LEFT = np.array([1.0, 0.0, 0.0])
#: A vertex beside the ray counts as so many times its distance less far along it.
_BESIDE = 2.0
#: Between the heads of the bones spine02 and spine01, the height of the breastbone's end and of the tenth vertebra.
_CHEST_END = 0.35
#: Spines of the pelvis, from the hip joint or the middle, in distances between the hip joints: anterior ones are so far
#: above it; posterior ones so far above it, and from the middle.
_ASIS_UP, _PSIS_UP, _PSIS_OUT = 0.32, 0.36, 0.2
_FINGERS = ("Index", "Middle", "Ring", "Little")


@functools.cache
def landmark_vertices() -> Int[ndarray, " m"]:
    """The vertex of each landmark, in the order of ``LANDMARKS``: on the default body at rest the outermost where a ray
    from inside leaves the skin."""
    model = BodyModel.load()
    body = model.shape(Phenotype())
    heads = dict(zip(model.bone_names, body.rest_heads, strict=True))
    bones = np.array(model.bone_names)[model.skin_indices[:, 0]]
    vertices = body.rest_vertices.astype(np.float64)

    def outermost(origin: ndarray, direction: ndarray, *names: str) -> int:
        """Of the vertices that move most with bones of these beginnings."""
        along = (vertices - origin) @ unit(direction)
        beside = np.linalg.norm(vertices - origin - along[:, None] * unit(direction), axis=1)
        among = np.char.startswith(bones, names[0])
        for name in names[1:]:
            among |= np.char.startswith(bones, name)
        return int(np.argmax(np.where(among & (along > 0), along - _BESIDE * beside, -np.inf)))

    places = _of_head_and_trunk(heads, vertices, bones, outermost)
    for side, out in (("R", -_LEFT), ("L", _LEFT)):
        places |= {f"{side}{name}": vertex for name, vertex in _of_a_leg(heads, side, out, outermost).items()}
        places |= {f"{side}{name}": vertex for name, vertex in _of_an_arm(heads, side, outermost).items()}
    return np.array([places[name] for name in LANDMARK_NAMES])


_Outermost = Callable[..., int]


def _of_head_and_trunk(
    heads: dict[str, ndarray], vertices: ndarray, bones: ndarray, outermost: _Outermost
) -> dict[str, int]:
    chest = heads["spine02"] + _CHEST_END * (heads["spine01"] - heads["spine02"])
    notch = (heads["clavicle.R"] + heads["clavicle.L"]) / 2
    trunk = ("spine", "clavicle", "breast", "shoulder", "neck", "root", "pelvis")
    # Bones of the face have many names, none of which is lower than the jaw's joint.
    face = (vertices[:, 2] > heads["jaw"][2] - 0.03) & (np.abs(vertices[:, 0]) < 0.02)
    head = np.flatnonzero(vertices[:, 2] > heads["head"][2])
    places = {
        "Crown": int(vertices[:, 2].argmax()),
        "Nose": int(np.where(face, -vertices[:, 1], -np.inf).argmax()),
        "C7": outermost(heads["neck01"], _BACK, *trunk),
        "T10": outermost(chest, _BACK, *trunk),
        "JugularNotch": outermost(notch, _FORWARD, *trunk),
        "Xiphoid": outermost(chest, _FORWARD, *trunk),
        "REar": int(head[vertices[head, 0].argmin()]),
        "LEar": int(head[vertices[head, 0].argmax()]),
    }
    apart = float(heads["upperleg01.L"][0] - heads["upperleg01.R"][0])
    for side, out in (("R", -_LEFT), ("L", _LEFT)):
        hip, shoulder = heads[f"upperleg01.{side}"], heads[f"upperarm01.{side}"]
        places[f"{side}Acromion"] = outermost(shoulder, _UP, *trunk, f"upperarm01.{side}")
        thigh = (*trunk, f"upperleg01.{side}", f"upperleg02.{side}")
        places[f"{side}Asis"] = outermost(hip + _ASIS_UP * apart * _UP, _FORWARD, *thigh)
        middle = np.array([0.0, hip[1], hip[2]])
        places[f"{side}Psis"] = outermost(middle + _PSIS_UP * apart * _UP + _PSIS_OUT * apart * out, _BACK, *thigh)
        places[f"{side}Trochanter"] = outermost(hip, out, *thigh)
    return places


def _of_a_leg(heads: dict[str, ndarray], side: str, out: ndarray, outermost: _Outermost) -> dict[str, int]:
    knee, ankle = heads[f"lowerleg01.{side}"], heads[f"foot.{side}"]
    leg = tuple(f"{bone}.{side}" for bone in ("upperleg01", "upperleg02", "lowerleg01", "lowerleg02", "foot"))
    sole = np.array([ankle[0], ankle[1], heads[f"toe1-1.{side}"][2]])
    first, last = heads[f"toe1-1.{side}"], heads[f"toe1-2.{side}"]
    toes = (f"foot.{side}", *(f"toe{i}-{k}.{side}" for i in range(1, 6) for k in range(1, 4)))
    return {
        "KneeLateral": outermost(knee, out, *leg),
        "KneeMedial": outermost(knee, -out, *leg),
        "AnkleLateral": outermost(ankle, out, *leg),
        "AnkleMedial": outermost(ankle, -out, *leg),
        "Heel": outermost(sole, _BACK, *leg),
        "BigToeBase": outermost(first, _UP, *toes),
        "SmallToeBase": outermost(heads[f"toe5-1.{side}"], _UP, *toes),
        "Toe": outermost(last, last - first, *toes),
    }


def _of_an_arm(heads: dict[str, ndarray], side: str, outermost: _Outermost) -> dict[str, int]:
    shoulder, elbow, wrist = (heads[f"{bone}.{side}"] for bone in ("upperarm01", "lowerarm01", "wrist"))
    arm = tuple(f"{bone}.{side}" for bone in ("upperarm01", "upperarm02", "lowerarm01", "lowerarm02", "wrist"))
    # With the pit of the elbow to the front and the arm out to the side, the lateral epicondyle is above.
    lateral = np.cross(elbow - shoulder, wrist - elbow) * (1 if side == "R" else -1)
    thumb = heads[f"finger1-1.{side}"] - wrist
    forearm = unit(wrist - elbow)
    radial = thumb - (thumb @ forearm) * forearm
    places = {
        "ElbowLateral": outermost(elbow, lateral, *arm),
        "ElbowMedial": outermost(elbow, -lateral, *arm),
        "WristRadial": outermost(wrist, radial, *arm),
        "WristUlnar": outermost(wrist, -radial, *arm),
    }
    # Of the back of the hand: the palm's side is where the thumb's end is.
    index, little = heads[f"finger2-1.{side}"], heads[f"finger5-1.{side}"]
    dorsal = np.cross(index - wrist, little - wrist)
    dorsal = -dorsal * np.sign(dorsal @ (heads[f"finger1-3.{side}"] - wrist))
    hand = tuple(f"{bone}.{side}" for bone in ("wrist", *(f"metacarpal{i}" for i in range(1, 5))))
    for number, name in enumerate(("Thumb", *_FINGERS), 1):
        joints = tuple(f"finger{number}-{k}.{side}" for k in (1, 2, 3))
        before, end = heads[joints[1]], heads[joints[2]]
        places[f"{name}Tip"] = outermost(end, end - before, *joints)
        if number > 1:
            places[f"Knuckle{name}"] = outermost(heads[joints[0]], dorsal, *joints, *hand)
    return places


def posed_landmarks(body: Body, postures: Float[ndarray, "t 20 3"]) -> Float[ndarray, "t m 3"]:
    """Landmarks of a body in postures (metres, Z up), with the joint Hip where it is at rest."""
    vertices, model = landmark_vertices(), body.model
    rest, indices, weights = (array[vertices] for array in (body.rest_vertices, model.skin_indices, model.skin_weights))
    return np.stack([body.bone_transforms(posture).skin(rest, indices, weights) for posture in postures])
