"""Rows of the body model and the renderer."""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy import ndarray
from timing import Bench, Reference

from depthmocap.geometry import DepthCamera, look_at
from depthmocap.geometry.transforms import transform_points
from depthmocap.synth.body.bones import world_rotations
from depthmocap.synth.body.mesh import Body, BodyModel
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.bodies import ONE_CHARACTER
from depthmocap.synth.render import render_body
from depthmocap.synth.sensing.sensors import SENSORS

GOAL_MS = 2.0
BATCH = 32


def camera_before(centre: ndarray, distance_m: float, name: str = "camera") -> DepthCamera:
    """A Kinect 2 that looks at a point from a little above it and from −Y."""
    eye = centre + np.array([0.3, -0.98, 0.2]) / np.linalg.norm([0.3, -0.98, 0.2]) * distance_m
    return SENSORS["ubc3v"].camera(name, look_at(eye, centre))


def rendering(bench: Bench) -> None:
    """One view of a body against Embree, a general ray caster. Both draw on one thread; Embree builds on all cores."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    body = BodyModel.load().shape(ONE_CHARACTER)
    posed = body.pose(PosturePrior.load().sample(np.random.default_rng(1))[0])
    camera = camera_before(posed.vertices.mean(0).astype(float), 2.0)
    points, faces, regions = posed.by_region()
    # Rays of depth 1, so that the length Embree finds is the depth. The rays are made beforehand.
    ones = np.ones((camera.height, camera.width, 1), np.float32)
    all_rays = np.concatenate([camera.rays, ones], -1)

    def build() -> Any:
        scene = EmbreeScene()
        TriangleMesh(scene, np.ascontiguousarray(transform_points(camera.camera_from_world, points)), faces)
        return scene

    def cast(scene: Any, rays: ndarray) -> tuple[ndarray, ndarray]:
        flat = np.ascontiguousarray(rays.reshape(-1, 3))
        hits = scene.run(np.zeros_like(flat), flat, output=1)
        face, hit = hits["primID"], hits["primID"] >= 0
        depth = np.where(hit, hits["tfar"], 0).astype(np.float32)
        labels = np.where(hit, regions[face], 0).astype(np.uint8)
        return depth.reshape(rays.shape[:2]), labels.reshape(rays.shape[:2])

    scene = build()
    depth, labels = render_body(posed, camera)
    cast_depth, cast_labels = cast(scene, all_rays)
    person = labels > 0
    differing = int(np.count_nonzero(labels != cast_labels))
    error_mm = float(np.abs(depth - cast_depth)[person & (cast_labels > 0)].max() * 1e3)
    agrees = bool(differing <= 1e-3 * person.sum() and error_mm < 1)
    agreement = f"{person.sum()} person px, {differing} labels differ, depth within {error_mm:.2g} mm"
    rows, columns = np.flatnonzero(person.any(1)), np.flatnonzero(person.any(0))
    box_rays = all_rays[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]

    def ours() -> object:
        return render_body(posed, camera)

    for reference, note in (
        (Reference("Embree, scene built for the view", lambda: cast(build(), all_rays)), agreement),
        (Reference("Embree, scene kept", lambda: cast(scene, all_rays)), "as if the body never moved"),
        (Reference("Embree, scene kept, person's box", lambda: cast(scene, box_rays)), "as if its box were known, too"),
    ):
        bench.measure("Render a body, 512×424", ours, reference, goal_ms=GOAL_MS, agrees=agrees, note=note)


def rendering_open3d(bench: Bench) -> None:
    """One view of a body against Open3D's ray casting, on one thread each and with Open3D on all."""
    open3d: Any = importlib.import_module("open3d")  # not in the extras: it brings a notebook's worth of packages
    body = BodyModel.load().shape(ONE_CHARACTER)
    posed = body.pose(PosturePrior.load().sample(np.random.default_rng(1))[0])
    camera = camera_before(posed.vertices.mean(0).astype(float), 2.0)
    points, triangles, regions = posed.by_region()
    regions = np.append(regions, 0).astype(np.uint8)
    vertices = open3d.core.Tensor(points)
    faces = open3d.core.Tensor(triangles.astype(np.uint32))
    # Rays of depth 1, so that Open3D returns the depth. The rays are made beforehand.
    ones = np.ones((camera.height, camera.width, 1), np.float32)
    directions = np.concatenate([camera.rays, ones], -1) @ camera.world_from_camera[:3, :3].T.astype(np.float32)
    eye = np.broadcast_to(camera.world_from_camera[:3, 3].astype(np.float32), directions.shape)
    rays = open3d.core.Tensor(np.ascontiguousarray(np.concatenate([eye, directions], -1)))

    def cast(threads: int) -> tuple[ndarray, ndarray]:
        scene = open3d.t.geometry.RaycastingScene(nthreads=threads)
        scene.add_triangles(vertices, faces)
        hits = scene.cast_rays(rays, nthreads=threads)
        depth = hits["t_hit"].numpy()
        face = hits["primitive_ids"].numpy()
        labels = regions[np.minimum(face, len(regions) - 1)]
        return np.where(np.isfinite(depth), depth, 0), labels

    depth, labels = render_body(posed, camera)
    cast_depth, cast_labels = cast(1)
    both = (labels > 0) & (cast_labels > 0)
    differing = int(np.count_nonzero(labels != cast_labels))
    error_mm = float(np.abs(depth - cast_depth)[both].max() * 1e3)
    agrees = bool(differing <= 1e-3 * both.sum() and error_mm < 1)
    note = f"{differing} labels differ, depth within {error_mm:.2g} mm"
    for threads in sorted({1, bench.threads}):
        name = f"Open3D {open3d.__version__} ray casting, {threads} thread" + "s" * (threads > 1)
        bench.measure(
            "Render a body, 512×424", lambda: render_body(posed, camera),
            Reference(name, lambda threads=threads: cast(threads)), goal_ms=GOAL_MS, agrees=agrees, note=note,
        )  # fmt: skip


def posing(bench: Bench) -> None:
    """Posing and shaping against Anny's own functions in PyTorch, one body and a batch."""
    import torch

    model = BodyModel.load()
    anny: Any = model._anny  # the model inside ours, which the references need
    prior, rng = PosturePrior.load(), np.random.default_rng(2)
    postures = np.stack([prior.sample(rng)[0] for _ in range(BATCH)])
    body = model.shape(ONE_CHARACTER)
    values = torch.tensor([[getattr(ONE_CHARACTER, label) for label in anny.phenotype_labels]]).float()
    none = torch.zeros(1, 0)
    torch.set_num_threads(bench.threads)

    def coefficients(count: int) -> Any:
        empty = none.expand(count, 0)
        return anny._get_phenotype_blendshape_coefficients(values.expand(count, -1), empty, empty)

    with torch.no_grad():
        rest = anny.get_rest_model(coefficients(1))
    poses = _world_orientations(body, postures, rest["rest_bone_poses"][0].numpy())
    deltas = torch.from_numpy(poses)

    def pose(count: int) -> Any:
        with torch.inference_mode():
            shape = rest["rest_bone_poses"].expand(count, -1, -1, -1)
            transforms, _ = anny.get_bone_transforms(deltas[:count], shape, "world-orient")
            return anny.get_skinned_vertices(rest["rest_vertices"].expand(count, -1, -1), transforms)

    def forward(count: int) -> Any:
        parameters = {label: values[:, i].expand(count) for i, label in enumerate(anny.phenotype_labels)}
        with torch.inference_mode():
            return anny(deltas[:count], parameters, pose_parameterization="world-orient")["vertices"]

    ours = np.stack([body.pose(posture).vertices for posture in postures])
    error_mm = max(float(np.abs(f(BATCH).numpy() - ours).max()) for f in (pose, forward)) * 1e3
    agrees, note = error_mm < 0.1, f"vertices within {error_mm:.2g} mm"
    threads = f"{bench.threads} thread" + "s" * (bench.threads > 1)

    for count in (1, BATCH):
        size = f"batch of {count}, {threads}"
        bench.measure(
            "Pose a shaped body", lambda: body.pose(postures[0]),
            Reference(f"Anny, posing alone, {size}", lambda count=count: pose(count), count),
            goal_ms=GOAL_MS, agrees=agrees, note=note,
        )  # fmt: skip
    for count in (1, BATCH):
        size = f"batch of {count}, {threads}"
        bench.measure(
            "Shape and pose a body", lambda: model.shape(ONE_CHARACTER).pose(postures[0]),
            Reference(f"Anny, forward, {size}", lambda count=count: forward(count), count),
            agrees=agrees, note=note,
        )  # fmt: skip
    bench.measure("Shape a body", lambda: model.shape(ONE_CHARACTER), note="calls Anny's functions")


def _world_orientations(body: Body, postures: ndarray, rest_bone_poses: ndarray) -> ndarray:
    """Anny's parameters (n, bones, 4, 4), world orientations and the root's place, of our postures."""
    rotations = world_rotations(postures)[:, body.model.posture_of_bone]
    poses = np.tile(np.eye(4, dtype=np.float32), (*rotations.shape[:2], 1, 1))
    poses[..., :3, :3] = rotations @ rest_bone_poses[:, :3, :3]
    poses[:, 0, :3, 3] = body.rest_heads[0]
    return poses
