"""The drawings of the conventions: axes of world and camera, the 18 joints, the 43 regions. Needs the extra train.

python docs/scripts/conventions.py docs/images
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy import ndarray

from depthmocap.body.regions import DISPLAY_COLOURS, REGION_NAMES
from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.geometry import DepthCamera, look_at
from depthmocap.synth.body.mesh import BodyModel, Phenotype, PosedBody
from depthmocap.synth.render import render_body

AXES = {"x": "#d62728", "y": "#2ca02c", "z": "#1f77b4"}
RIGHT, LEFT, MIDDLE = "#c44e52", "#4c72b0", "#444444"
#: Pixels of a side of a picture.
VIEW = 400


def axes_of(ax: Any, pose: ndarray, name: str, length: float) -> None:
    """The three axes of a frame."""
    at = pose[:3, 3]
    for axis, (letter, colour) in enumerate(AXES.items()):
        end = at + length * pose[:3, axis]
        ax.plot(*np.stack([at, end]).T, color=colour, linewidth=2.5)
        ax.text(*(at + 1.16 * length * pose[:3, axis]), letter, color=colour, ha="center", va="center", weight="bold")
    ax.text(*(at - 0.3 * length * pose[:3, :3].sum(1)), name, ha="center", va="center", weight="bold")


def draw_frames(path: Path) -> None:
    """World and camera, the floor, and somebody's skeleton in the middle."""
    body = standing()
    figure = plt.figure(figsize=(7, 4.6))
    ax = figure.add_subplot(projection="3d", computed_zorder=False)
    grid = np.linspace(-1.5, 1.5, 7)
    for each in grid:
        ax.plot([each, each], [-2.5, 1.5], [0, 0], color="#dddddd", linewidth=0.8)
    for each in np.linspace(-2.5, 1.5, 9):
        ax.plot([-1.5, 1.5], [each, each], [0, 0], color="#dddddd", linewidth=0.8)
    joints = body.joints - [0, 0, body.vertices[:, 2].min()]
    for a, b in BONES:
        ax.plot(*joints[[JOINT_INDEX[a], JOINT_INDEX[b]]].T, color="#888888", linewidth=2)
    axes_of(ax, np.eye(4), "world", 0.7)
    camera = look_at(np.array([1.3, -2.4, 1.3]), np.array([0.0, 0.0, 1.0]))
    axes_of(ax, camera, "camera", 0.5)
    corners = np.array([[s * 0.25, t * 0.18, 0.45] for s, t in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    corners = corners @ camera[:3, :3].T + camera[:3, 3]
    ax.plot(*np.vstack([corners, corners[:1]]).T, color="#999999", linewidth=1)
    for corner in corners:
        ax.plot(*np.stack([camera[:3, 3], corner]).T, color="#999999", linewidth=1)
    ax.set(xlim=(-1.5, 1.5), ylim=(-2.5, 1.5), zlim=(0, 1.9))
    ax.set_box_aspect((3, 4, 1.9), zoom=1.4)  # pyright: ignore[reportArgumentType] - any number will do
    ax.view_init(20, -35)
    ax.set_axis_off()
    save(figure, path)


def standing() -> PosedBody:
    """The body on which the regions are drawn, in the pose it rests in."""
    return BodyModel.load().shape(Phenotype()).pose(np.zeros((20, 3)))


def picture(body: PosedBody, behind: bool) -> tuple[ndarray, DepthCamera]:
    """Regions in colour on white, from far away so that nothing is foreshortened."""
    middle = (body.vertices.min(0) + body.vertices.max(0)) / 2
    towards = np.array([0.0, 1.0 if behind else -1.0, 0.0])
    far, tall = 20.0, np.ptp(body.vertices[:, 2])
    focal = 0.94 * VIEW * far / tall
    pose = look_at(middle + far * towards, middle)
    camera = DepthCamera("front", VIEW, VIEW, focal, focal, (VIEW - 1) / 2, (VIEW - 1) / 2, pose)
    depth, labels = render_body(body, camera)
    colours = DISPLAY_COLOURS[labels].astype(float)
    slope = np.gradient(np.where(depth > 0, depth, np.nan))
    shade = 1 / np.sqrt(1 + np.nansum(np.square(slope), 0) * (focal / far) ** 2 / 2)
    colours = np.where(depth[..., None] > 0, colours * (0.45 + 0.55 * shade[..., None]), 255)
    return colours.astype(np.uint8), camera


def draw_skeleton(path: Path) -> None:
    """The 18 joints by name, from the front: the subject's right is on the left."""
    body = standing()
    figure, ax = plt.subplots(figsize=(7, 5.2))
    colours, camera = picture(body, behind=False)
    ax.imshow(np.where(colours.min(2, keepdims=True) < 255, 225, 255).repeat(3, 2).astype(np.uint8))
    places = camera.project(body.joints)[:, :2]
    for a, b in BONES:
        ax.plot(*places[[JOINT_INDEX[a], JOINT_INDEX[b]]].T, color="#777777", linewidth=2)
    for i, name in enumerate(JOINTS):
        colour = {"R": RIGHT, "L": LEFT}.get(name[0] if name[1].isupper() else "", MIDDLE)
        ax.plot(*places[i], "o", color=colour, markersize=6)
        if colour == MIDDLE:
            down, right = (18, -14) if name == "Hip" else (7, 10)
            ax.text(places[i, 0] + right, places[i, 1] + down, f"{i} {name}", color=colour)
            continue
        side = -1 if colour == RIGHT else 1
        edge = VIEW / 2 + side * VIEW * 0.42
        ax.annotate(
            f"{i} {name}", places[i], (edge, places[i, 1]), color=colour, va="center",
            ha="right" if side < 0 else "left", arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5},
        )  # fmt: skip
    ax.set(xlim=(-VIEW * 0.22, VIEW * 1.22))
    ax.set_axis_off()
    save(figure, path)


def draw_regions(path: Path) -> None:
    """The 43 regions from the front and from behind, with their numbers, names and colours."""
    body = standing()
    figure, (front, back, names) = plt.subplots(1, 3, figsize=(13, 5), width_ratios=(1, 1, 1.9))
    for ax, behind, title in ((front, False, "front"), (back, True, "back")):
        ax.imshow(picture(body, behind)[0][:, VIEW // 8 : -VIEW // 8])
        ax.set_title(title)
        ax.set_axis_off()
    rows = 15
    for number, name in enumerate(REGION_NAMES[1:], start=1):
        x, y = (number - 1) // rows, rows - (number - 1) % rows
        names.add_patch(
            Rectangle((x, y - 0.35), 0.12, 0.7, facecolor=DISPLAY_COLOURS[number] / 255, edgecolor="#999999")
        )
        names.text(x + 0.14, y, f"{number} {name}", va="center", fontsize=8)
    names.set(xlim=(0, 3), ylim=(0.3, rows + 0.7))
    names.set_axis_off()
    save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Without the time of day in it, so that the same drawing is the same file."""
    metadata = {"Date": None} if path.suffix == ".svg" else None
    figure.savefig(path, facecolor="white", bbox_inches="tight", pad_inches=0.05, dpi=130, metadata=metadata)
    plt.close(figure)


def main(folder: Path) -> None:
    """Draw all of them."""
    plt.rcParams.update(
        {"svg.hashsalt": "depthmocap", "svg.fonttype": "none", "font.family": "sans-serif", "font.size": 9}
    )
    draw_frames(folder / "frames.svg")
    draw_skeleton(folder / "joints.webp")
    draw_regions(folder / "regions.webp")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
