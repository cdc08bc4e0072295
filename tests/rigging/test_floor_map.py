"""The map of the floor, where to walk next, and what is said of cameras that will not do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from rig_states import calibration, observations, rig_state

from depthmocap.cameras.source import ConnectedCamera
from depthmocap.frames import FrameSet
from depthmocap.geometry import Rig
from depthmocap.realtime.status import CameraStatus
from depthmocap.recordings.open_recording import open_recording, packaged_recording
from depthmocap.rigging.floor_map import CELL_M, advice, draw_map, place_words
from depthmocap.rigging.floor_picture import floor_picture
from depthmocap.rigging.rig_faults import camera_faults, connection_faults, same_pictures, same_views
from depthmocap.rigging.walk_observer import Sight


@pytest.fixture(scope="module")
def frames() -> FrameSet:
    return open_recording(packaged_recording())[0]


@pytest.fixture(scope="module")
def rig(frames: FrameSet) -> Rig:
    return Rig(tuple(view.camera for view in frames.views))


def test_the_floor_fills_where_somebody_walked_and_the_next_place_is_elsewhere(rig: Rig) -> None:
    drawn = draw_map(calibration(rig, 30.0, 8.0), observations(rig))
    x, y = np.moveaxis(drawn.centres_m(), -1, 0)
    for name in rig.names:
        walked = drawn.seen[name] > 0
        assert drawn.seen[name].sum() == 30
        assert np.abs(y[walked]).max() <= CELL_M and -CELL_M < x[walked].min() < x[walked].max() < 0.6 + CELL_M
    # The least certain pair is the first two: where both see a person, and nobody has been.
    assert drawn.next_m is not None
    i, j = ((drawn.next_m - drawn.corner_m) / CELL_M).astype(int)[::-1]
    assert drawn.visible["cam0"][i, j] and drawn.visible["cam1"][i, j] and not drawn.seen["cam0"][i, j]
    picture = floor_picture(drawn, dict.fromkeys(rig.names, (200, 40, 40)))
    assert picture.shape == (12 * drawn.shape[0], 12 * drawn.shape[1], 3) and (picture == 255).any()
    assert place_words(np.zeros(2), rig).startswith("where it is ")


def test_what_stands_before_the_person_hides_them(rig: Rig) -> None:
    seen = observations(rig)
    free = draw_map(calibration(rig, 30.0, 8.0), seen)
    wall = [dataclasses.replace(each, empty_m=np.full_like(each.empty_m, 0.8)) for each in seen]
    hidden = draw_map(calibration(rig, 30.0, 8.0), wall)
    assert free.visible["cam0"].any() and not hidden.visible["cam0"].any() and hidden.next_m is None


def test_advice(rig: Rig) -> None:
    names, seen = rig.names, dict.fromkeys(rig.names, (30, 30))
    drawn = draw_map(calibration(rig, 30.0, 8.0), observations(rig))
    assert "one person" in advice(names, {}, None, None, "")
    assert "walk where camera 'cam2' can see you" in advice(names, {**seen, "cam2": (0, 9)}, None, None, "")
    assert advice(names, seen, None, None, "no two cameras see") == "no two cameras see"
    left = calibration(rig, 30.0, 8.0, unplaced={"cam9": "only 3 poses agree"})
    assert "'cam9'" in advice(names, seen, left, drawn, "")
    assert "the ring on the map" in advice(names, seen, calibration(rig, 30.0, 8.0), drawn, "")
    assert "the ring" not in advice(names, seen, calibration(rig, 5.0, 8.0), drawn, "")


def test_what_is_wrong_is_said_in_words(frames: FrameSet) -> None:
    connected = [ConnectedCamera("azure:1", "Azure Kinect", "1", "it is on USB 2")]
    told = connection_faults(connected, {"kinect2": "pip install"})
    assert told == ["azure:1: it is on USB 2", "kinect2: pip install"]
    shape = frames.views[0].depth_m.shape
    dark = {"b": Sight(np.zeros(shape, np.float32), None)}
    states = {"a": "lost", "b": "running", "c": "running"}
    statuses = [CameraStatus(name, state, 30.0, 0.0, 0, {}) for name, state in states.items()]
    faults = camera_faults(statuses, dark, {"a": (5, 90), "b": (3, 90), "c": (0, 90)})
    assert faults["a"] == "lost" and "hardly a pixel" in faults["b"] and "not seen the person" in faults["c"]


def test_one_device_named_twice_and_two_cameras_at_one_place(frames: FrameSet, rig: Rig) -> None:
    one, two = (Sight(view.depth_m, None) for view in frames.views[:2])
    assert not same_pictures({"left": one, "right": two})
    assert "named twice" in same_pictures({"left": one, "right": one})[0]
    twin = dataclasses.replace(rig.cameras[0], name="twin")
    assert not same_views(rig)
    assert "cameras 'cam0' and 'twin' see the same" in same_views(Rig((*rig.cameras, twin)))[0]


def test_a_state_tells_its_pairs(frames: FrameSet) -> None:
    lines = rig_state(frames, 30.0, 8.0).pair_lines()
    assert lines == [("cam0 – cam1", "± 30.0 mm, 0.20°: fair"), ("cam0 – cam2", "± 8.0 mm, 0.20°: good")]
    assert rig_state(frames, 30.0, 8.0, calibration=None).pair_lines() == []
