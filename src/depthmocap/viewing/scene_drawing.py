"""What is drawn in space: floor and axes, cameras, the room's point cloud, skeletons and their trails.

The number of nodes is fixed, and each is changed in place: what a slow browser has not fetched is replaced by what is
newer, and nothing piles up.
"""

from __future__ import annotations

import collections
from collections.abc import Sequence
from typing import Literal

import numpy as np
import viser
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray
from scipy.spatial.transform import Rotation

from depthmocap.body.skeleton import BONES, JOINT_INDEX, JOINTS
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, transform_points, z_up_from
from depthmocap.geometry.floor_area import FloorArea
from depthmocap.geometry.transforms import unit
from depthmocap.report.drawing import colour_labels
from depthmocap.viewing.display_colours import distance_colours, line_colours, palette_colour
from depthmocap.viewing.viewer_page import plain

CloudColours = Literal["camera", "depth", "body part"]
Colour = tuple[int, int, int]
#: Depth (m) from which on colours of depth are distinguished,
NEAREST_M = 0.5
#: and up to which.
FARTHEST_M = 5.0
#: Joints that leave a trail.
TRAILING = ("Head", "RHand", "LHand", "RFoot", "LFoot")
#: Poses that a trail shows at most.
TRAIL_LENGTH = 30
#: Nanoseconds that a trail shows at most.
TRAIL_NS = 1_000_000_000
_BONE_ENDS = np.array([[JOINT_INDEX[parent], JOINT_INDEX[child]] for parent, child in BONES])
_TRAILING = [JOINT_INDEX[joint] for joint in TRAILING]
_BACKGROUND = (23.0, 23.0, 28.0)
_GREY = np.full(3, 130.0)
_PLANES: dict[str, Literal["xy", "xz"]] = {"z": "xy", "y": "xz", "-y": "xz"}

#: The border of an area is drawn so far above the floor (metres).
_ABOVE_FLOOR_M = 0.01


def camera_points(view: View, stride: int) -> tuple[Float32[ndarray, "n 3"], Float32[ndarray, " n"], ndarray]:
    """World points (m) of every so many pixels and rows with depth, their depth, and the mask of these pixels in the
    picture of every so many."""
    depth_m, rays = view.depth_m[::stride, ::stride], view.camera.rays[::stride, ::stride]
    valid = (depth_m > 0) & np.isfinite(rays[..., 0])
    z = depth_m[valid].astype(np.float32)
    points_camera = np.concatenate([rays[valid] * z[:, None], z[:, None]], 1)
    return transform_points(view.camera.world_from_camera, points_camera), z, valid


def stride_for(views: Sequence[View], most: int) -> int:
    """The least stride with which all pictures together have at most so many pixels."""
    pixels = sum(view.depth_m.size for view in views)
    return max(int(np.ceil(np.sqrt(pixels / max(most, 1)))), 1)


class SceneDrawing:
    """Floor, axes, cameras and the cloud of the room, in the rig's own world."""

    def __init__(self, server: viser.ViserServer, cameras: Sequence[DepthCamera], up: str) -> None:
        self._scene, self._up = server.scene, up
        self.up_world = z_up_from(up).T @ np.array([0.0, 0.0, 1.0])
        self._scene.set_up_direction(tuple(self.up_world.tolist()))
        # Near the middle of the cameras: half precision is for metres, not for kilometres.
        places = np.array([camera.world_from_camera[:3, 3] for camera in cameras] or [np.zeros(3)])
        self._origin = places.mean(0).round()
        floor = self._origin - self.up_world * (self._origin @ self.up_world)
        self.floor = self._scene.add_grid(
            "/floor", width=12.0, height=12.0, plane=_PLANES[up], cell_color=(60, 60, 70), section_color=(95, 95, 110),
            position=floor, shadow_opacity=0.0,
        )  # fmt: skip
        self.axes = self._scene.add_frame("/axes", axes_length=0.4, axes_radius=0.008, position=floor)
        self._cloud = self._scene.add_point_cloud(
            "/cloud", np.zeros((1, 3)), np.zeros((1, 3), np.uint8), point_size=0.009, point_shading="flat",
            position=self._origin, visible=False,
        )  # fmt: skip
        self._area = self._scene.add_line_segments(
            "/area", np.zeros((1, 2, 3)), (120, 200, 255), thickness=0.02, visible=False
        )
        self.cameras = CamerasDrawing(self._scene, cameras)

    def show_area(self, corners_m: FloorArea) -> None:
        """The area of the floor in which people are followed; nothing where that is everywhere."""
        self._area.visible = bool(corners_m)
        if not corners_m:
            return
        flat = np.zeros((len(corners_m), 3))
        flat[:, [0, 1] if self._up == "z" else [0, 2]] = corners_m
        flat += _ABOVE_FLOOR_M * self.up_world
        self._area.points = np.stack([flat, np.roll(flat, -1, 0)], 1).astype(np.float32)

    def look_from(self, server: viser.ViserServer, target: Float[ndarray, "3"], cameras: Sequence[DepthCamera]) -> None:
        """Where browsers look from at first: at the target, from a little above and before the first camera, where
        nothing that it has seen is in the way."""
        place = cameras[0].world_from_camera[:3, 3] if cameras else target + 2.5 * self._sideways()
        server.initial_camera.up = tuple(self.up_world.tolist())
        server.initial_camera.look_at = target
        server.initial_camera.position = place + 0.35 * self.up_world + 0.5 * unit(target - place)
        server.initial_camera.fov = 1.0

    def _sideways(self) -> Float[ndarray, "3"]:
        """A horizontal direction."""
        return z_up_from(self._up).T @ np.array([0.6, -0.8, 0.0])

    def hide_cloud(self) -> None:
        """Show no cloud."""
        self._cloud.visible = False

    def show_cloud(
        self,
        views: Sequence[View],
        colours: CloudColours,
        most: int,
        labels: Sequence[UInt8[ndarray, "_ _"]] = (),
    ) -> None:
        """The cloud of all views, thinned to at most so many points.

        Args:
            labels: the body regions in each view, for colours by body part.
        """
        stride = stride_for(views, most)
        parts, part_colours = [], []
        for i, view in enumerate(views):
            points, depth_m, valid = camera_points(view, stride)
            if colours == "depth":
                shown = distance_colours(depth_m.astype(np.float64), NEAREST_M, FARTHEST_M)
            else:
                colour = self.cameras.colour(view.camera.name) if colours == "camera" else _GREY
                near = 1.0 - 0.45 * np.clip((depth_m - NEAREST_M) / (FARTHEST_M - NEAREST_M), 0, 1)
                shown = (near[:, None] * colour.astype(np.float32)).astype(np.uint8)
            if colours == "body part" and i < len(labels):
                regions = labels[i][::stride, ::stride][valid]
                shown = np.where(regions[:, None] > 0, colour_labels(regions[None])[0], shown)
            parts.append(points - self._origin.astype(np.float32))
            part_colours.append(shown)
        points = np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
        self._cloud.visible = bool(len(points))
        if len(points):
            self._cloud.points = points.astype(np.float16)
            self._cloud.colors = np.concatenate(part_colours)


class CamerasDrawing:
    """A frustum and a label for each camera."""

    def __init__(self, scene: viser.SceneApi, cameras: Sequence[DepthCamera]) -> None:
        self._scene, self._visible = scene, True
        self._frusta: dict[str, tuple[viser.CameraFrustumHandle, viser.LabelHandle]] = {}
        for camera in cameras:
            self.add(camera)

    def add(self, camera: DepthCamera) -> None:
        """Draw one more camera."""
        if camera.name in self._frusta:
            return
        index = len(self._frusta)
        x, y, z, w = Rotation.from_matrix(camera.world_from_camera[:3, :3]).as_quat()
        frustum = self._scene.add_camera_frustum(
            f"/cameras/{index}", float(2 * np.arctan2(camera.height / 2, camera.fy)), camera.width / camera.height,
            scale=0.18, thickness=0.006, color=palette_colour(index), wxyz=(w, x, y, z),
            position=camera.world_from_camera[:3, 3], cast_shadow=False, receive_shadow=False,
            visible=self._visible,
        )  # fmt: skip
        label = self._scene.add_label(f"/cameras/{index}/name", plain(camera.name), anchor="bottom-center")
        self._frusta[camera.name] = (frustum, label)

    def colour(self, name: str) -> Float[ndarray, "3"]:
        """The colour of a camera's points."""
        names = list(self._frusta)
        return np.array(palette_colour(names.index(name) if name in names else 0), np.float64)

    def show_state(self, name: str, text: str, colour: Colour | None) -> None:
        """A line beside the camera's name, and its frustum's colour; None is the camera's own."""
        if name not in self._frusta:
            return
        frustum, label = self._frusta[name]
        shown = f"{plain(name)} {plain(text)}".strip()
        of_camera = palette_colour(list(self._frusta).index(name))
        if label.text != shown:
            label.text = shown
        if frustum.color != (colour or of_camera):
            frustum.color = colour or of_camera

    @property
    def visible(self) -> bool:
        """Whether cameras are drawn."""
        return self._visible

    @visible.setter
    def visible(self, visible: bool) -> None:
        self._visible = visible
        for frustum, _ in self._frusta.values():
            frustum.visible = visible


class SkeletonDrawing:
    """One skeleton: bones, joints, a name above its head, and trails of hands, feet and head."""

    def __init__(
        self, scene: viser.SceneApi, path: str, up_world: Float[ndarray, "3"], thickness_m: float = 0.022
    ) -> None:
        """``path`` is the node's name in the scene, not a person's."""
        self._up, self._shown = up_world, False
        self._bones = scene.add_line_segments(
            f"{path}/bones", np.zeros((len(BONES), 2, 3)), np.zeros((len(BONES), 2, 3), np.uint8),
            thickness=thickness_m, visible=False,
        )  # fmt: skip
        self._joints = scene.add_point_cloud(
            f"{path}/joints", np.zeros((len(JOINTS), 3)), np.zeros((len(JOINTS), 3), np.uint8),
            point_size=1.8 * thickness_m, point_shape="circle", precision="float32", visible=False,
        )  # fmt: skip
        self._label = scene.add_label(f"{path}/name", "", visible=False, anchor="bottom-center")
        segments = len(TRAILING) * (TRAIL_LENGTH - 1)
        self._trails = scene.add_line_segments(
            f"{path}/trails", np.zeros((segments, 2, 3)), np.zeros((segments, 2, 3), np.uint8),
            thickness=0.4 * thickness_m, visible=False,
        )  # fmt: skip

    def hide(self) -> None:
        """Show nothing."""
        if self._shown:
            self._shown = False
            for node in (self._bones, self._joints, self._label, self._trails):
                node.visible = False

    def show(self, joints: Float[ndarray, "18 3"], colours: UInt8[ndarray, "18 3"], name: str = "") -> None:
        """Show a pose in the world (m), NaN where a joint was not observed, each joint in its colour."""
        observed = np.asarray(np.isfinite(joints).all(-1))
        if not observed.any():
            self.hide()
            return
        # What is missing becomes a point within a joint that is there, for the number of bones stays.
        anchor = int(np.argmax(observed))
        drawn = np.where(observed[:, None], joints, joints[anchor])
        drawn_colours = np.where(observed[:, None], colours, colours[anchor])
        both = np.asarray(observed[_BONE_ENDS].all(1))
        self._bones.points = np.where(both[:, None, None], drawn[_BONE_ENDS], joints[anchor]).astype(np.float32)
        self._bones.colors = line_colours(drawn_colours[_BONE_ENDS])
        self._joints.points = drawn.astype(np.float32)
        self._joints.colors = drawn_colours.astype(np.uint8)
        if name:
            top = drawn[np.argmax(drawn @ self._up)]
            self._label.position = top + 0.22 * self._up
            if self._label.text != name:
                self._label.text = name
        if self._label.visible != bool(name):
            self._label.visible = bool(name)
        if not self._shown:
            self._shown = True
            self._bones.visible = self._joints.visible = True

    def show_trails(self, poses: Sequence[Float[ndarray, "18 3"]], colour: Colour) -> None:
        """Trails through the last poses, the newest at the end; none hides them."""
        recent = list(poses)[-TRAIL_LENGTH:]
        if len(recent) < 2:
            self._trails.visible = False
            return
        path = np.stack(recent)[:, _TRAILING]
        segments = np.stack([path[:-1], path[1:]], 2)
        fade = np.linspace(0.0, 1.0, len(recent) + 1)[1:, None] * (np.array(colour) - _BACKGROUND) + _BACKGROUND
        colours = np.broadcast_to(np.stack([fade[:-1], fade[1:]], 1)[:, None], segments.shape)
        count = len(TRAILING) * (TRAIL_LENGTH - 1)
        known = np.isfinite(segments).all((-1, -2))
        points, shown = segments[known], colours[known].astype(np.uint8)
        if not len(points):
            self._trails.visible = False
            return
        missing = count - len(points)
        self._trails.points = np.concatenate([points, np.repeat(points[-1:, 1:], missing, 0).repeat(2, 1)]).astype(
            np.float32
        )
        self._trails.colors = line_colours(np.concatenate([shown, np.repeat(shown[-1:], missing, 0)]))
        self._trails.visible = True


class Trail:
    """The poses of somebody over the last moment, for :meth:`SkeletonDrawing.show_trails`.

    Attributes:
        poses: joints (m), the newest at the end.
    """

    def __init__(self) -> None:
        self.poses: collections.deque[Float[ndarray, "18 3"]] = collections.deque(maxlen=TRAIL_LENGTH)
        self._stamps_ns: collections.deque[int] = collections.deque(maxlen=TRAIL_LENGTH)

    def add(self, joints: Float[ndarray, "18 3"], timestamp_ns: int) -> None:
        """Add a pose; those that are older than a trail by this time are forgotten."""
        self.poses.append(joints)
        self._stamps_ns.append(timestamp_ns)
        while abs(timestamp_ns - self._stamps_ns[0]) > TRAIL_NS:
            self._stamps_ns.popleft()
            self.poses.popleft()
