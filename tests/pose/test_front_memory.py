"""Which way somebody faces is kept where single frames take front for back, and follows those who turn."""

from __future__ import annotations

import numpy as np
import pytest

from depthmocap.body.regions import REGION, TURNED
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS, MIRROR
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.pose.front_memory import FrontMemory
from depthmocap.pose.labelled_view import LabelledView

CAMERA = DepthCamera("camera", 8, 6, 10.0, 10.0, 4.0, 3.0)
VIEW = View(CAMERA, np.full((6, 8), 2.0, np.float32))
LABELS = np.full((6, 8), REGION["chest L"], np.uint8)
FRAME_NS = 33_000_000


def part(heading_deg: float, log_odds: float, turned: bool = False) -> LabelledView:
    """What a view says of an upright body (z up) with that heading; or of it taken front for back."""
    joints = np.zeros((len(JOINTS), 4))
    joints[JOINT_INDEX["Neck"], 2] = 0.5
    angle = np.radians(heading_deg)
    for name, x in (("LShoulder", 0.2), ("LHip", 0.1), ("RShoulder", -0.2), ("RHip", -0.1)):
        joints[JOINT_INDEX[name], :3] = [x * np.cos(angle), x * np.sin(angle), 0.5 if "Shoulder" in name else 0.0]
    labels = LABELS
    if turned:
        joints, labels = joints[MIRROR], TURNED[labels].astype(np.uint8)
    return LabelledView(VIEW, labels, np.full((6, 8), 0.7, np.float32), joints, log_odds)


def heading_deg(view: LabelledView) -> float:
    assert view.joints is not None
    across = view.joints[JOINT_INDEX["LShoulder"], :2] - view.joints[JOINT_INDEX["RShoulder"], :2]
    return float(np.degrees(np.arctan2(across[1], across[0])))


def test_a_body_does_not_turn_round_from_one_frame_to_the_next() -> None:
    memory = FrontMemory()
    for frame in range(60):
        (view,) = memory([part(20, 3.0)], frame * FRAME_NS)
        assert heading_deg(view) == pytest.approx(20)
        assert view.front_log_odds >= 3.0
    (view,) = memory([part(20, 2.0, turned=True)], 60 * FRAME_NS)
    assert heading_deg(view) == pytest.approx(20)
    assert (view.labels == LABELS).all()
    assert 0 < view.front_log_odds < 3.0


def test_what_lasts_is_believed_in_the_end() -> None:
    memory = FrontMemory()
    for frame in range(300):
        memory([part(0, 3.0, turned=True)], frame * FRAME_NS)
    turned_at = None
    for frame in range(300, 500):
        (view,) = memory([part(0, 3.0)], frame * FRAME_NS)
        if turned_at is None and abs(heading_deg(view)) < 1:
            turned_at = frame
        assert turned_at is None or abs(heading_deg(view)) < 1
    assert turned_at is not None
    assert 0.3 < (turned_at - 300) * FRAME_NS / 1e9 < 3.0


def test_who_turns_is_followed() -> None:
    memory = FrontMemory()
    for frame in range(120):  # three turns, each within a second and a third
        (view,) = memory([part(9.0 * frame, 1.0)], frame * FRAME_NS)
        assert (heading_deg(view) - 9.0 * frame + 180) % 360 == pytest.approx(180)


def test_a_single_start_that_was_wrong_does_not_bind() -> None:
    memory = FrontMemory()
    memory([part(0, 0.5, turned=True)], 0)
    (view,) = memory([part(0, 2.0)], FRAME_NS)
    assert heading_deg(view) == pytest.approx(0)


def test_what_was_seen_long_ago_does_not_count() -> None:
    memory = FrontMemory()
    for frame in range(60):
        memory([part(0, 5.0)], frame * FRAME_NS)
    assert memory.knows(61 * FRAME_NS) and not memory.knows(120 * FRAME_NS)
    (view,) = memory([part(0, 0.5, turned=True)], 120 * FRAME_NS)
    assert abs(heading_deg(view)) == pytest.approx(180)


def test_views_that_tell_nothing_stay_as_they_are() -> None:
    memory = FrontMemory()
    silent = part(0, float("nan"))
    assert memory([silent], 0)[0] is silent
    no_joints = part(0, 3.0)._replace(joints=None)
    assert memory([no_joints], FRAME_NS)[0] is no_joints
    assert memory([], 2 * FRAME_NS) == []
