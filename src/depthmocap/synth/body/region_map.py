"""The 43 regions drawn on the body's mesh, by measurements on the default body in the rest pose.

Lengths are shares of the stature, so that the rules read like an artist's canon. R is the subject's right, at −x;
the body faces −y.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from numpy import ndarray

from depthmocap.body.regions import REGION

# Along a stretched arm, from the wrist joint upwards, and along the leg, as shares of the stature.
_WRIST, _FOREARM, _ELBOW_BELOW, _ELBOW_ABOVE, _UPPER_ARM = 0.063, 0.062, 0.018, 0.037, 0.075
_KNEE_HALF, _ANKLE_ABOVE = 0.05, 0.035
# Heights on the torso, below the crown.
_CHEST_BOTTOM, _BACK_BOTTOM = 0.38, 0.347
_COLLAR_BOTTOM, _ARMPIT, _BLADES_BOTTOM = 0.208, 0.255, 0.262


def _sided(mask: Bool[ndarray, "f"], right: Bool[ndarray, "f"], name: str, out: UInt8[ndarray, "f"]) -> None:
    out[mask & right] = REGION[f"{name} R"]
    out[mask & ~right] = REGION[f"{name} L"]


def _starts(bones: Shaped[ndarray, "f"], *prefixes: str) -> Bool[ndarray, "f"]:
    return np.array([str(bone).startswith(prefixes) for bone in bones])


def _along(points: Float[ndarray, "f 3"], a: Float[ndarray, "3"], b: Float[ndarray, "3"]) -> Float[ndarray, "f"]:
    """Distance from ``a`` in the direction of ``b``."""
    return (points - a) @ ((b - a) / np.linalg.norm(b - a))


def face_regions(
    vertices: Float[ndarray, "v 3"],
    faces: Int[ndarray, "f 3"],
    vertex_bones: Shaped[ndarray, "v"],
    heads: dict[str, Float[ndarray, "3"]],
) -> UInt8[ndarray, "f"]:
    """Region of every face, from the rest mesh, each vertex's main bone and the bones' heads."""
    corners = vertices[faces]
    points = corners.mean(1).astype(np.float64)
    bones = vertex_bones[faces[:, 0]]
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    right = points[:, 0] < 0
    crown = float(vertices[:, 2].max())
    stature = crown - float(vertices[:, 2].min())
    below_crown = (crown - z) / stature
    out = np.zeros(len(faces), dtype=np.uint8)

    arm = _starts(bones, "upperarm", "lowerarm", "wrist", "finger", "metacarpal")
    leg = _starts(bones, "upperleg", "lowerleg", "foot", "toe")
    neck = _starts(bones, "neck")
    torso = _starts(bones, "root", "pelvis", "spine", "breast", "clavicle", "shoulder01")
    head = ~(arm | leg | neck | torso)

    _torso(points, x, y, z, right, below_crown, stature, heads, out)
    _head_and_neck(points, x, y, z, right, head, neck, crown, heads, out)
    _legs(points, x, y, z, right, leg, stature, vertices, heads, out)
    _arms(points, y, right, arm, bones, stature, heads, out)
    return out


def _torso(points, x, y, z, right, below_crown, stature, heads, out) -> None:
    shoulder, hip = heads["upperarm01.L"], heads["upperleg01.L"]
    # The side seam: through the shoulder joint above, the widest point of the trunk below.
    waist = np.abs(below_crown - 0.40) < 0.02
    flank = waist & (x > np.quantile(x[waist & (x < shoulder[0])], 0.93)) & (x < shoulder[0])
    seam = np.interp(z, [hip[2], points[flank, 2].mean(), shoulder[2]], [hip[1], y[flank].mean(), shoulder[1]])
    front = y < seam
    wide = x > 0.72 * shoulder[0]
    _sided(front & (below_crown < _CHEST_BOTTOM), right, "chest", out)
    _sided(front & (below_crown >= _CHEST_BOTTOM), right, "belly", out)
    _sided(~front & (below_crown < _BACK_BOTTOM), right, "upper back", out)
    _sided(~front & (below_crown >= _BACK_BOTTOM), right, "lower back", out)
    # The slope of the trapezius falls away to the side and belongs to the collar from behind too.
    slope = shoulder[2] + 0.035 * stature - 0.28 * (x - 0.035 * stature)
    _sided(front & (below_crown < _COLLAR_BOTTOM) & ~wide, right, "collar", out)
    _sided(~front & (z > slope) & ~wide, right, "collar", out)
    nape = ~front & (x < 0.04 * stature) & (below_crown < _BLADES_BOTTOM)
    out[nape] = REGION["nape"]
    _sided(front & wide & (below_crown < _ARMPIT), right, "shoulder front", out)
    _sided(~front & wide & (below_crown < _ARMPIT), right, "shoulder back", out)


def _head_and_neck(points, x, y, z, right, head, neck, crown, heads, out) -> None:
    eye, skull = heads["eye.L"], heads["head"]
    brow = eye[2] + 0.022
    height = crown - brow
    ear_back = skull[1] + 0.035  # behind the ear
    chin = eye[2] - 0.115
    _sided(head, right, "hair", out)
    # The hairline runs from the temple down in front of the ear's top, and behind the ear down to the nape.
    _sided(head & (z < brow) & (y < ear_back), right, "face", out)
    front = y < skull[1] - 0.02
    out[head & front & (z >= brow) & (z < brow + 0.6 * height) & (x < 0.058)] = REGION["forehead"]
    throat = head & (z < chin + np.clip(y - eye[1], 0, None) * 0.45) & (z < eye[2] - 0.06)
    under = neck | throat
    axis = np.interp(z, [heads["neck01"][2], skull[2]], [heads["neck01"][1], skull[1]])
    forward, side = axis - y, x
    _sided(under, right, "neck back", out)
    out[under & (forward > 0) & (side < 1.0 * forward)] = REGION["neck front"]
    out[neck & (forward < 0) & (z < heads["neck01"][2] + 0.015) & (x < 0.05)] = REGION["nape"]


def _legs(points, x, y, z, right, leg, stature, vertices, heads, out) -> None:
    hip, knee, ankle = (heads[f"{bone}.L"] for bone in ("upperleg01", "lowerleg01", "foot"))
    mid = np.abs(vertices[:, 0]) < 0.01
    groin = float(vertices[mid & (vertices[:, 2] < hip[2] + 0.05), 2].min())
    # In front the thigh begins at the inguinal line, behind at the fold of the buttock.
    inguinal = np.interp(x, [0.0, 0.10 * stature], [groin + 0.005, hip[2] + 0.035])
    fold = np.interp(x, [0.0, 0.10 * stature], [groin - 0.02, groin + 0.02])
    blend = np.clip((y - hip[1] + 0.04) / 0.08, 0, 1)
    start = inguinal * (1 - blend) + fold * blend
    near = (z < hip[2] + 0.10) & (x < 2 * hip[0] + 0.02) & (z > knee[2])
    left_points = np.stack([x, y, z], -1)
    thigh = (leg | near) & (z < start)
    _sided(thigh, right, "thigh", out)
    down_thigh = _along(left_points, hip, knee)
    down_shin = _along(left_points, knee, ankle)
    thigh_length, shin_length = np.linalg.norm(knee - hip), np.linalg.norm(ankle - knee)
    at_knee = leg & (down_thigh > thigh_length - _KNEE_HALF * stature) & (down_shin < _KNEE_HALF * stature)
    _sided(at_knee, right, "knee", out)
    below = leg & (down_shin >= _KNEE_HALF * stature)
    _sided(below, right, "shin", out)
    at_ankle = below & (down_shin > shin_length - _ANKLE_ABOVE * stature)
    _sided(at_ankle, right, "ankle", out)
    toe = float(vertices[vertices[:, 2] < ankle[2], 1].min())
    _sided(at_ankle & (z < ankle[2] + 0.02) & (y < ankle[1] + 0.38 * (toe - ankle[1])), right, "forefoot", out)


def _arms(points, y, right, arm, bones, stature, heads, out) -> None:
    shoulder, elbow, wrist = (heads[f"{bone}.L"] for bone in ("upperarm01", "lowerarm01", "wrist"))
    left_points = np.stack([np.abs(points[:, 0]), points[:, 1], points[:, 2]], -1)
    lower_length, upper_length = np.linalg.norm(elbow - wrist), np.linalg.norm(shoulder - elbow)
    # Shares of the stature scaled to this body's own bones, so that the elbow stays on its joint.
    lower_scale = lower_length / (_WRIST + _FOREARM + _ELBOW_BELOW)
    upper_scale = upper_length / 0.16
    up_lower = _along(left_points, wrist, elbow)
    up_upper = _along(left_points, elbow, shoulder)
    upper = arm & (up_upper > 0)
    lower = arm & ~upper
    front = y < shoulder[1] + 0.3 * (elbow[1] - shoulder[1]) * np.clip(1 - up_upper / upper_length, 0, 1)
    _sided(upper & front, right, "shoulder front", out)
    _sided(upper & ~front, right, "shoulder back", out)
    _sided(upper & (up_upper < (_ELBOW_ABOVE + _UPPER_ARM) * upper_scale), right, "upper arm", out)
    _sided(upper & (up_upper < _ELBOW_ABOVE * upper_scale), right, "elbow", out)
    _sided(lower, right, "elbow", out)
    _sided(lower & (up_lower < (_WRIST + _FOREARM) * lower_scale), right, "forearm", out)
    _sided(lower & (up_lower < _WRIST * lower_scale), right, "wrist", out)
    _sided(lower & ((up_lower < 0) | _starts(bones, "finger", "metacarpal")), right, "hand", out)
