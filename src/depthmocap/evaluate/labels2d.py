"""``depthmocap evaluate labels2d``: are the regions of real depth images where a 2D pose estimator saw the joints?"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from depthmocap.body.regions import MIRROR, REGION
from depthmocap.classify.classifier import Classifier
from depthmocap.core.console import Terminal
from depthmocap.core.locks import locks_outputs
from depthmocap.core.network_devices import NetworkSettings, networks_on
from depthmocap.core.output import check_outputs
from depthmocap.core.reading.image_files import read_picture
from depthmocap.core.reading.json_text import array, read_json
from depthmocap.errors import InputError
from depthmocap.evaluate.evaluation_report import JsonOutput
from depthmocap.frames import View
from depthmocap.geometry.depth_camera import DepthCamera

#: Regions that a joint seen from any side may lie on; R and L are added for its side.
ALLOWED: dict[str, tuple[str, ...]] = {
    "nose": ("face R", "face L", "forehead"),
    "Shoulder": ("shoulder front", "shoulder back", "collar", "upper arm", "upper back", "chest"),
    "Elbow": ("upper arm", "elbow", "forearm"),
    "Hand": ("hand", "wrist"),
    "Hip": ("belly", "lower back", "thigh"),
    "Knee": ("knee", "thigh", "shin"),
    "Foot": ("ankle", "forefoot"),
}


@dataclasses.dataclass(frozen=True)
class Labels2dEvaluation(NetworkSettings, JsonOutput):
    """Check labels of real depth images against joints found in colour images.

    Attributes:
        folder: NAME.png (16-bit depth of one person, 0 elsewhere) and joints2d.json, which holds
            {NAME: {joint: [u, v, confidence]}} with the joints nose, RShoulder, LElbow, … of the table above.
        fx: focal length in pixels, by default 1.07 of the width.
        depth_unit: metres of one depth unit.
        confidence: joints below it are left out.
        radius: an allowed region within so many pixels of the joint counts.
        weights: a classifier.onnx of your own.
    """

    folder: tyro.conf.Positional[Path]
    fx: float | None = None
    depth_unit: float = 0.001
    confidence: float = 0.9
    radius: int = 3
    weights: Path | None = None

    def __post_init__(self) -> None:
        check_outputs({"--json": self.json}, {"the pictures": self.folder, "what --weights names": self.weights})


def _allowed(joint: str) -> list[int]:
    if joint == "nose":
        return [REGION[name] for name in ALLOWED[joint]]
    side, kind = joint[:1], joint[1:]
    if side not in "RL" or kind not in ALLOWED:
        raise InputError(f"unknown joint {joint!r}: expected nose, or R or L and one of {list(ALLOWED)[1:]}")
    return [REGION[f"{name} {side}"] for name in ALLOWED[kind]]


def _read_joints(path: Path) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Place and confidence of joints by picture and name."""
    document = read_json(path)
    if not isinstance(document, dict) or not all(isinstance(joints, dict) for joints in document.values()):
        raise InputError(f"{path} must hold {{picture: {{joint: [u, v, confidence]}}}}")
    people: dict[str, dict[str, tuple[float, float, float]]] = {}
    for name, joints in document.items():
        people[name] = {}
        for joint, place in joints.items():
            u, v, confidence = array(place, (3,), f"{path}: {joint} of {name}").tolist()
            people[name][joint] = (u, v, confidence)
    return people


@locks_outputs(files=("json",))
def evaluate_labels2d(settings: Labels2dEvaluation, console: Console | None = None) -> dict[str, Any]:
    """Count joints on a region of their own, and on the other side's; returns the numbers.

    Raises:
        InputError: files that are missing or not of the layout.
    """
    path = settings.folder / "joints2d.json"
    people = _read_joints(path)
    with networks_on(settings.device):
        classifier = Classifier(settings.weights)
    right: dict[str, int] = {}
    total: dict[str, int] = {}
    swapped: list[str] = []
    pictures = 0
    for name, joints in sorted(people.items()):
        picture = settings.folder / f"{name}.png"
        if not picture.is_file():
            continue
        pictures += 1
        depth = read_picture(picture)
        if depth.ndim != 2:
            raise InputError(f"{picture}: depth must be one channel, got shape {depth.shape}")
        depth = depth.astype(np.float32) * np.float32(settings.depth_unit)
        height, width = depth.shape
        focal = settings.fx or 1.07 * width
        camera = DepthCamera("camera", width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)
        ((labels, *_),) = classifier.label_views([View(camera, depth)], [depth > 0])
        for joint, (u, v, confidence) in joints.items():
            if confidence < settings.confidence:
                continue
            column, row, reach = round(u), round(v), settings.radius
            near = labels[max(row - reach, 0) : row + reach + 1, max(column - reach, 0) : column + reach + 1]
            kind, allowed = joint.lstrip("RL"), _allowed(joint)
            total[kind] = total.get(kind, 0) + 1
            if np.isin(near, allowed).any():
                right[kind] = right.get(kind, 0) + 1
            elif joint != "nose" and np.isin(near, MIRROR[allowed]).any():
                swapped.append(f"{name} {joint}")
    if not total:
        raise InputError(f"{settings.folder}: no picture has a joint of confidence {settings.confidence} or more")
    numbers = {
        "pictures": pictures,
        "joints": sum(total.values()),
        "on_own_region": sum(right.values()) / sum(total.values()),
        "by_joint": {kind: right.get(kind, 0) / count for kind, count in total.items()},
        "count_by_joint": total,
        "on_other_side": swapped,
    }
    settings.write_numbers(numbers)
    console = console or Terminal(stderr=True)
    table = Table(title=f"{settings.folder.name}: {pictures} pictures, {numbers['joints']} joints")
    for heading in ("joint", "on a region of its own", "of"):
        table.add_column(heading, justify="left" if heading == "joint" else "right")
    for kind, count in total.items():
        table.add_row(kind, str(right.get(kind, 0)), str(count))
    table.add_row("all", f"{numbers['on_own_region']:.1%}", str(numbers["joints"]))
    console.print(table)
    console.print(f"on the other side's region: {len(swapped)} {', '.join(swapped)}")
    return numbers
