"""Depth cameras: projection there and back, raw units, and the rig file with all that can be wrong in it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera, Rig, check_extrinsics, load_rig, look_at, save_rig, transform_points

#: Lenses of a PrimeSense and a Kinect 2, and a strong barrel.
LENSES = {
    "none": (0.0, 0.0, 0.0, 0.0, 0.0),
    "pincushion": (0.196, -0.367, -0.0025, -0.0019, 0.0),
    "kinect 2": (0.09, -0.27, 0.0, 0.0, 0.09),
    "barrel": (-0.2, 0.05, 0.001, -0.001, 0.0),
}


def make_camera(name: str = "cam0", **changes: Any) -> DepthCamera:
    pose = look_at(np.array([1.0, -2.5, 1.4]), np.array([0.1, 0.0, 0.9]), 0.05)
    camera = DepthCamera(name, 160, 120, 133.0, 132.0, 81.5, 58.25, pose)
    return dataclasses.replace(camera, **changes)


@pytest.mark.parametrize("lens", LENSES)
def test_unproject_then_project(lens: str) -> None:
    camera = make_camera(distortion=LENSES[lens])
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 6, (120, 160))
    depth[rng.random(depth.shape) < 0.2] = 0
    points = camera.unproject(depth)
    v, u = np.nonzero(depth)
    assert points.shape == (len(v), 3)
    np.testing.assert_allclose(points[:, 2], depth[v, u], rtol=1e-6)
    uvz = camera.project(transform_points(camera.world_from_camera, points.astype(np.float64)))
    # The inverse of the lens is found by iteration: a twentieth of a pixel at worst, in the corners.
    tolerance = 1e-3 if lens == "none" else 0.05
    np.testing.assert_allclose(uvz[:, :2], np.stack([u, v], -1), atol=tolerance)
    np.testing.assert_allclose(uvz[:, 2], depth[v, u], rtol=1e-5)


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("quarters", [1, 2, 3, 4])
def test_a_turned_camera_sees_the_same(lens: str, quarters: int) -> None:
    camera = make_camera(distortion=LENSES[lens])
    depth = np.random.default_rng(0).uniform(0.5, 6, (120, 160))
    turned = camera.turned(quarters)
    picture = np.rot90(depth, quarters)
    assert picture.shape == (turned.height, turned.width)
    points = np.rot90(
        transform_points(camera.world_from_camera, camera.unproject(depth)).reshape(120, 160, 3), quarters
    )
    there = transform_points(turned.world_from_camera, turned.unproject(picture)).reshape(points.shape)
    np.testing.assert_allclose(there, points, atol=2e-3)
    np.testing.assert_allclose(turned.project(points.astype(np.float64))[..., 2], picture, atol=1e-5)


@pytest.mark.parametrize(("roll_deg", "quarters"), [(0, 0), (30, 0), (-40, 0), (90, 1), (80, 1), (180, 2), (-90, 3)])
def test_upright(roll_deg: float, quarters: int) -> None:
    """Turned as told, the world's up is up in the picture within half a right angle."""
    pose = look_at(np.array([1.0, -2.5, 1.4]), np.array([0.1, 0.0, 0.9]), np.deg2rad(roll_deg))
    camera = make_camera(world_from_camera=pose)
    up = np.array([0.0, 0.0, 1.0])
    turns = camera.quarters_upright(up)
    assert turns in (quarters, (4 - quarters) % 4)
    low, high = camera.turned(turns).project(np.array([[0.1, 0.0, 0.9], [0.1, 0.0, 1.2]]))[:, :2]
    assert low[1] - high[1] > abs(low[0] - high[0]) * 0.99


def test_nearest_pixels() -> None:
    camera = make_camera(world_from_camera=np.eye(4))
    depth = np.full((120, 160), 2.0, np.float32)
    far = np.array([[1e300, 0.0, 1e-3], [0.0, 0.0, -1.0], [-50.0, 1e30, 1.0]])
    row, column = camera.nearest_pixels(np.concatenate([camera.unproject(depth)[[0, 161]].astype(float), far]))
    assert row[:2].tolist() == [0, 1] and column[:2].tolist() == [0, 1]
    assert not ((row[2:] >= 0) & (row[2:] < 120) & (column[2:] >= 0) & (column[2:] < 160)).any()


def test_no_upright_where_none_is_known() -> None:
    up = np.array([0.0, 0.0, 1.0])
    down = make_camera(world_from_camera=look_at(np.array([0.0, 0.0, 3.0]), np.array([0.1, 0.0, 0.0]), 2.0))
    assert down.quarters_upright(up) == 0
    assert make_camera(world_from_camera=np.eye(4)).quarters_upright(np.array([0.0, 1.0, 0.0])) == 0


def test_integer_pixel_is_its_centre() -> None:
    camera = make_camera(cx=80.0, cy=60.0, world_from_camera=np.eye(4))
    np.testing.assert_array_equal(camera.rays[60, 80], [0, 0])
    np.testing.assert_allclose(camera.project(np.array([0.0, 0.0, 2.0])), [80, 60, 2])
    # One step right in the picture is +x, one step down +y.
    np.testing.assert_allclose(camera.rays[61, 81], [1 / 133, 1 / 132], rtol=1e-6)
    np.testing.assert_array_equal(camera.matrix @ [0, 0, 1], [80, 60, 1])


def test_unproject_takes_masked_valid_pixels_in_order() -> None:
    camera = make_camera()
    depth = np.full((120, 160), 2.0, dtype=np.float32)
    depth[10, 10] = 0
    depth[11, 11] = np.nan
    mask = np.zeros(depth.shape, dtype=bool)
    mask[9:12, 9:12] = True
    points = camera.unproject(depth, mask)
    assert points.dtype == np.float32
    assert len(points) == 7
    assert (np.diff(points[:, 1]) >= 0).all()
    assert np.isfinite(points).all()


def test_points_behind_the_camera_have_no_pixel() -> None:
    camera = make_camera(world_from_camera=np.eye(4))
    uvz = camera.project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0], [0.1, 0.1, 1.0]]))
    assert np.isnan(uvz[:2, :2]).all()
    assert np.isfinite(uvz[2]).all()
    np.testing.assert_allclose(uvz[:, 2], [-1, 0, 1])


def test_to_metres() -> None:
    camera = make_camera(depth_unit_m=0.0001)
    metres = camera.to_metres(np.array([[0, 12345, 65535]], dtype=np.uint16))
    assert metres.dtype == np.float32
    np.testing.assert_allclose(metres, [[0, 1.2345, 0]])


def test_to_metres_mends_pictures() -> None:
    camera = make_camera(depth_unit_m=0.0001, depth_factor=4.0, mirrored=True)
    metres = camera.to_metres(np.array([[0, 12345, 65535, 20]], dtype=np.uint16))
    np.testing.assert_allclose(metres, [[0.008, 0, 4.938, 0]])


def test_rig_round_trip(tmp_path: Path) -> None:
    lens = LENSES["kinect 2"]
    rig = Rig(
        (make_camera("left", distortion=lens, depth_unit_m=0.0002, time_offset_s=-0.125), make_camera("right")), "-y"
    )
    mended = dataclasses.replace(rig["right"], depth_factor=4.0, mirrored=True)
    rig = Rig((rig["left"], mended), rig.up, ((-1.0, 0.5), (2.0, 0.5), (2.0, 3.0)))
    save_rig(rig, tmp_path / "rig.json")
    loaded = load_rig(tmp_path / "rig.json")
    assert loaded.names == ("left", "right")
    assert (loaded.up, loaded.area_m) == ("-y", rig.area_m)
    for name in rig.names:
        for field in dataclasses.fields(DepthCamera):
            np.testing.assert_array_equal(getattr(loaded[name], field.name), getattr(rig[name], field.name))
    with pytest.raises(KeyError, match="middle"):
        loaded["middle"]


def plain_document() -> dict[str, Any]:
    intrinsics = {"width": 64, "height": 48, "fx": 50, "fy": 50, "cx": 32, "cy": 24}
    return {"cameras": [{"name": name, **intrinsics, "world_from_camera": np.eye(4).tolist()} for name in "ab"]}


def test_rig_defaults(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(plain_document()))
    rig = load_rig(path)
    assert (rig.up, rig.area_m) == ("z", ())
    assert rig["b"].distortion == LENSES["none"]
    assert rig["b"].depth_unit_m == 0.001


def test_cameras_that_nobody_placed(tmp_path: Path) -> None:
    document = plain_document()
    for camera in document["cameras"]:
        del camera["world_from_camera"]
    (tmp_path / "rig.json").write_text(json.dumps(document))
    rig = load_rig(tmp_path / "rig.json")
    np.testing.assert_array_equal(rig["a"].world_from_camera, np.eye(4))
    check_extrinsics(rig.cameras[:1])
    with pytest.raises(InputError, match=r"'a' and 'b' have the same place.*calibrate"):
        check_extrinsics(rig.cameras)
    moved = np.eye(4)
    moved[0, 3] = 1e-3
    check_extrinsics([rig["a"], dataclasses.replace(rig["b"], world_from_camera=moved)])


def _set(key: str, value: Any) -> Callable[[dict[str, Any]], None]:
    return lambda document: document["cameras"][1].__setitem__(key, value)


def _mirrored(document: dict[str, Any]) -> None:
    document["cameras"][1]["world_from_camera"][0][0] = -1


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda d: d.clear(), "at least one camera"),
        (lambda d: d.update(cameras=[]), "at least one camera"),
        (lambda d: d.update(cameras={"a": 1}), "at least one camera"),
        (lambda d: d["cameras"].append("c"), "camera 2 must be an object"),
        (lambda d: (d["cameras"][1].pop("fx"), d["cameras"][1].pop("width")), "camera 'b' lacks width, fx"),
        (lambda d: d["cameras"][1].pop("name"), "camera 1 lacks name"),
        (_set("fx", "wide"), "camera 'b': fx must be a finite number, got \"wide\""),
        (_set("fx", "365.5"), "fx must be a finite number"),
        (_set("fx", None), "fx must be a finite number, got null"),
        (_set("fx", True), "fx must be a finite number, got true"),
        (_set("fx", 10**39), r"fx must be 1 to 1e\+06 pixels"),
        (_set("fx", 0.7), r"fx must be 1 to 1e\+06 pixels"),
        (_set("width", float("inf")), "width must be a whole number, got inf"),
        (_set("width", 64.5), "width must be a whole number"),
        (_set("cx", float("nan")), "cx must be a finite number, got nan"),
        (_set("fy", 0), "fy must be 1 to"),
        (_set("height", -48), "picture is 64×-48"),
        (_set("height", 0), "picture is 64×0"),
        (lambda d: d["cameras"][1].update(width=60000, height=60000), "picture is 60000×60000.*at most 64 million"),
        (_set("time_offset_s", 4000), "time_offset_s must be -3600 to 3600 seconds, got 4000"),
        (_set("time_offset_s", "late"), "time_offset_s"),
        (_set("depth_factor", 0), "depth_factor must be 0.001 to 1000, got 0"),
        (_set("mirrored", 1), "mirrored must be true or false, got 1"),
        (_set("depth_unit_m", 0), "depth_unit_m must be 1e-07 to 1 metres, got 0"),
        (_set("distortion", [0.1, 0.2]), r"distortion \[k1, k2, p1, p2, k3\] must be 5 numbers"),
        (_set("distortion", {"k1": 0.1}), r"distortion \[k1, k2, p1, p2, k3\] must be 5 numbers"),
        (_set("distortion", [50, -30, 0, 0, 10]), "can be undone in [0-9]+ % of the picture only"),
        (_set("distortion", [1e300, -1e300, 0, 0, 1e300]), "can be undone in 0 % of the picture only"),
        (_set("distortion", [0.1, 0, 0, 0, float("inf")]), "must be a finite number"),
        (_set("world_from_camera", [1, 0, 0]), "must be 4×4"),
        (_set("world_from_camera", [[1, 0], [1]]), "must be 4×4"),
        (_set("world_from_camera", np.where(np.eye(4) > 0, 1.0, 1e200).tolist()), "not a rotation"),
        (_set("world_from_camera", [[1, 0, 0, 1e9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "must be in metres"),
        (_set("world_from_camera", (np.eye(4) * 1000).tolist()), "not a rotation and a translation"),
        (_set("world_from_camera", [[1, 0, 0, 2500], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "must be in metres"),
        (_mirrored, "camera 'b': world_from_camera is not a rotation"),
        (_set("name", "a"), "names must differ"),
        (lambda d: d.update(up="x"), 'up must be "z", "y" or "-y"'),
        (lambda d: d.update(up=None), "up must be"),
        (lambda d: d.update(area_m=[0, 0, 1, 0, 1, 1]), "area_m must be a list of at most 1000 corners"),
        (lambda d: d.update(area_m=[[0, 0], [1, 0], [1, "1"]]), "area_m must be a finite number"),
        (lambda d: d.update(area_m=[[0, 0], [1, 0]]), "area_m needs at least three corners, got 2"),
        (lambda d: d.update(area_m=[[0, 0], [1, 0], [2, 0]]), "area_m has corners that enclose nothing"),
    ],
)
def test_rig_errors(tmp_path: Path, spoil: Callable[[dict[str, Any]], Any], message: str) -> None:
    document = plain_document()
    spoil(document)
    path = tmp_path / "rig.json"
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=message) as raised:
        load_rig(path)
    assert str(path) in str(raised.value)


def test_rig_file_missing_or_not_json(tmp_path: Path) -> None:
    path = tmp_path / "rig.json"
    with pytest.raises(InputError, match="not found: a recording needs"):
        load_rig(path)
    with pytest.raises(InputError, match="cannot be read"):
        load_rig(tmp_path)
    path.write_text('{"cameras": [')
    with pytest.raises(InputError, match="not valid JSON"):
        load_rig(path)
    path.write_bytes(b"\xff\xfe\x00{")
    with pytest.raises(InputError, match="not valid JSON"):
        load_rig(path)
    path.write_text("[1, 2]")
    with pytest.raises(InputError, match="at least one camera"):
        load_rig(path)
