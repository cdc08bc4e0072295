"""Views that take left for right are put right by those that do not."""

import numpy as np
import pytest

from depthmocap.body.regions import REGION, TURNED, UNLABELLED
from depthmocap.body.skeleton import JOINTS, MIRROR
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.pose.mirrored import undo_mirrored

CAMERA = DepthCamera("camera", 8, 6, 10.0, 10.0, 4.0, 3.0)
SHOWN = ("hand R", "hand L", "thigh R", "face L", "nape", "shin R")
LABELS = np.array([[0, UNLABELLED, *(REGION[name] for name in SHOWN)]] * 6)
BODY = np.random.default_rng(3).normal(0, 0.4, (len(JOINTS), 3))


def part(
    seed: int, sure: float = 0.7, mirrored: bool = False, error_m: float = 0.05, off_m: float = 0.0
) -> LabelledView:
    """What a view says of the body, to some centimetres."""
    rng = np.random.default_rng(seed)
    places = BODY + rng.normal(0, 0.03, BODY.shape) + [off_m, 0, 0]
    labels = LABELS.astype(np.uint8)
    if mirrored:
        places, labels = places[MIRROR], np.where(labels < 44, TURNED[labels % 44], labels).astype(np.uint8)
    joints = np.concatenate([places, np.full((len(JOINTS), 1), error_m)], 1)
    view = View(CAMERA, np.full((6, 8), 2.0, np.float32))
    return LabelledView(view, labels, np.full((6, 8), sure, np.float32), joints)


def same(one: LabelledView, other: LabelledView) -> bool:
    assert one.joints is not None and other.joints is not None
    return np.array_equal(one.labels, other.labels) and np.array_equal(one.joints, other.joints)


@pytest.mark.parametrize("count", [2, 3, 5])
@pytest.mark.parametrize("number", [0, 1])
def test_the_least_sure_view_is_put_right(count: int, number: int) -> None:
    parts = [part(i, 0.55 if i == number else 0.7, i == number, 0.1 if i == number else 0.05) for i in range(count)]
    corrected = undo_mirrored(parts)
    assert same(corrected[number], part(number, error_m=0.1))
    assert all(view is before for i, (view, before) in enumerate(zip(corrected, parts, strict=True)) if i != number)
    assert not same(parts[number], corrected[number])  # what was given is not changed
    np.testing.assert_array_equal(corrected[number].labels[:, :2], LABELS[:, :2])


def test_two_that_are_sure_outvote_one_and_two_that_guess_do_not() -> None:
    parts = [part(0, 0.66, mirrored=True, error_m=0.04), part(1, 0.64), part(2, 0.62)]
    corrected = undo_mirrored(parts)
    assert same(corrected[0], part(0, error_m=0.04)) and corrected[1] is parts[1] and corrected[2] is parts[2]
    parts = [part(0, 0.5, mirrored=True), part(1, 0.75), part(2, 0.5, mirrored=True)]
    corrected = undo_mirrored(parts)
    assert same(corrected[0], part(0)) and corrected[1] is parts[1] and same(corrected[2], part(2))


def test_views_that_agree_or_tell_nothing_stay() -> None:
    parts = [part(0), part(1), part(2, off_m=0.3)]
    assert all(a is b for a, b in zip(undo_mirrored(parts), parts, strict=True))
    nobody = parts[1]._replace(labels=np.zeros((6, 8), np.uint8), joints=np.full((18, 4), np.nan))
    true = parts[1]._replace(weights=None, joints=None)
    for other in (nobody, true):
        parts = [part(0, mirrored=True), other]
        assert all(a is b for a, b in zip(undo_mirrored(parts), parts, strict=True))
    assert undo_mirrored([]) == []
    alone = [part(0, mirrored=True)]
    assert undo_mirrored(alone)[0] is alone[0]


def test_a_body_whose_sides_lie_together_is_left_alone() -> None:
    """From the side, left and right are a few centimetres apart in what views say, and exchanging them is a gamble."""
    parts = [part(0), part(1, 0.5, mirrored=True)]
    for view in parts:
        assert view.joints is not None
        view.joints[:, :3] *= 0.05
    assert all(a is b for a, b in zip(undo_mirrored(parts), parts, strict=True))


def test_the_cloud_has_them_put_right() -> None:
    parts = [part(0, 0.8), part(1, 0.6), part(2, 0.5, mirrored=True)]
    cloud = merge_views(parts)
    right = merge_views([part(0, 0.8), part(1, 0.6), part(2, 0.5)])
    np.testing.assert_array_equal(cloud.labels, right.labels)
    for a, b in zip(cloud.joints, right.joints, strict=True):
        assert a is not None and b is not None and np.array_equal(a, b)


def test_a_view_that_the_network_of_fronts_was_asked_about_does_not_outvote_the_others() -> None:
    """Its odds are of another scale than those of labels: with them alone it would overrule two sure views."""
    asked = part(0, 0.55, mirrored=True)._replace(front_log_odds=8.0)
    parts = [asked, part(1, 0.7), part(2, 0.7)]
    corrected = undo_mirrored(parts)
    assert same(corrected[0], part(0, 0.55)) and corrected[1] is parts[1] and corrected[2] is parts[2]
    assert corrected[0].front_log_odds == -8.0
    doubtful = part(0, 0.75, mirrored=True)._replace(front_log_odds=0.1)  # labels are sure, the network is not
    assert same(undo_mirrored([doubtful, part(1, 0.6)])[0], part(0, 0.75))
