"""Bones of constant length, on bodies whose lengths are known."""

from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.errors import InputError
from depthmocap.frames import Pose
from depthmocap.smooth.bone_lengths import RIGID_BONES, BoneLengthConstraint, BoneLengthSettings, enforce_lengths
from depthmocap.smooth.filters import load_filter
from depthmocap.synth.body.mesh import Body
from depthmocap.synth.motion.postures import PosturePrior

ENDS = np.array([[JOINT_INDEX[name] for name in bone] for bone in RIGID_BONES])


def lengths(joints: Float[ndarray, "*n 18 3"]) -> Float[ndarray, "*n 14"]:
    return np.linalg.norm(joints[..., ENDS[:, 0], :] - joints[..., ENDS[:, 1], :], axis=-1)


@pytest.fixture(scope="module")
def truths(default_body: Body) -> Float[ndarray, "120 18 3"]:
    """One body in many postures."""
    rng, prior = np.random.default_rng(0), PosturePrior.load()
    return np.stack([default_body.pose(prior.sample(rng)[0]).joints for _ in range(120)]).astype(np.float64)


def stream(joints: Float[ndarray, "t 18 3"], confidence: float = 1.0, start_s: float = 0.0) -> list[Pose]:
    return [
        Pose(round((start_s + i / 30) * 1e9), frame, np.where(np.isnan(frame).any(1), 0, confidence))
        for i, frame in enumerate(joints)
    ]


def apply(bones: BoneLengthConstraint, poses: list[Pose]) -> Float[ndarray, "t 18 3"]:
    return np.stack([bones(pose).joints for pose in poses])


def test_noise_of_joints_goes_and_their_error_with_it(truths: Float[ndarray, "120 18 3"]) -> None:
    noisy = truths + np.random.default_rng(1).normal(0, 0.015, truths.shape)
    constrained = apply(BoneLengthConstraint(), stream(noisy))
    settled = slice(60, None)
    assert lengths(constrained[settled]).std(0).max() < 0.003 < 0.01 < lengths(noisy[settled]).std(0).min()
    before, after = (np.linalg.norm(frame - truths, axis=-1)[settled].mean() for frame in (noisy, constrained))
    assert after < 0.93 * before
    # Noise across a short bone makes it look longer.
    assert np.abs(lengths(constrained[-1]) - lengths(truths[-1])).max() < 0.012


def test_lengths_come_out_exactly_and_the_least_is_moved() -> None:
    rng = np.random.default_rng(2)
    joints = rng.normal(0, 0.4, (18, 3))
    target_m = lengths(joints) * rng.uniform(0.9, 1.1, 14)
    adjusted = enforce_lengths(joints, np.ones(18), target_m)
    np.testing.assert_allclose(lengths(adjusted), target_m, atol=1e-3)
    # Forces of bones cancel within the body, so that its middle stays.
    np.testing.assert_allclose(adjusted.mean(0), joints.mean(0), atol=1e-6)
    # What was moved is a pull along bones: nothing that keeps all lengths would bring it nearer to the estimate.
    turned = adjusted - adjusted.mean(0)
    assert np.abs(np.cross(turned, adjusted - joints).sum(0)).max() < 2e-3


def test_sure_joints_hold_their_place(truths: Float[ndarray, "120 18 3"]) -> None:
    variance = np.ones(18)
    variance[JOINT_INDEX["RFoot"]] = 1e-4
    adjusted = enforce_lengths(truths[0], variance, lengths(truths[0]) * 1.1)
    shift = np.linalg.norm(adjusted - truths[0], axis=1)
    assert shift[JOINT_INDEX["RFoot"]] < 0.01 * shift[JOINT_INDEX["LFoot"]]


def test_joints_on_one_spot_stay_there(truths: Float[ndarray, "120 18 3"]) -> None:
    known = truths[0]
    for gap_m in (0.0, 1e-6, 0.03):
        joints = known.copy()
        joints[JOINT_INDEX["RHand"]] = joints[JOINT_INDEX["RElbow"]] + [gap_m, 0, 0]
        adjusted = enforce_lengths(joints, np.ones(18), 1.05 * lengths(known))
        assert np.linalg.norm(adjusted - joints, axis=1).max() < 0.06
        np.testing.assert_array_equal(adjusted[JOINT_INDEX["RHand"]], joints[JOINT_INDEX["RHand"]])


def test_a_side_is_learnt_from_the_other(truths: Float[ndarray, "120 18 3"]) -> None:
    hidden = truths.copy()
    hidden[:60, JOINT_INDEX["RHand"]] = np.nan
    hidden[60:, JOINT_INDEX["RHand"]] += 0.2 * (truths[60:, JOINT_INDEX["RHand"]] - truths[60:, JOINT_INDEX["RElbow"]])
    constrained = apply(BoneLengthConstraint(), stream(hidden))
    assert np.isnan(constrained[:60, JOINT_INDEX["RHand"]]).all()
    assert np.isfinite(np.delete(constrained, JOINT_INDEX["RHand"], axis=1)).all()
    bone = [child for _, child in RIGID_BONES].index("RHand")
    assert abs(lengths(constrained[60])[bone] - lengths(truths[60])[bone]) < 0.004


def test_poor_estimates_do_not_set_the_length(truths: Float[ndarray, "120 18 3"]) -> None:
    bones = BoneLengthConstraint()
    apply(bones, stream(truths[:20]))
    apply(bones, stream(1.3 * truths[20:60], confidence=0.1, start_s=20 / 30))
    np.testing.assert_allclose(bones.lengths_m, lengths(truths[0]), atol=0.005)


def test_another_person_has_other_lengths(truths: Float[ndarray, "120 18 3"]) -> None:
    bones = BoneLengthConstraint()
    apply(bones, stream(truths[:30]))
    child = 0.6 * truths[30:32]
    gone = stream(np.full((30, 18, 3), np.nan), start_s=1.0)
    assert np.isnan(apply(bones, gone)).all()
    np.testing.assert_allclose(apply(bones, stream(child, start_s=2.0)), child, atol=0.005)
    apply(bones, stream(truths[:30], start_s=9.0))
    np.testing.assert_allclose(apply(bones, stream(child)), child, atol=0.005)  # time went back


def test_filters_have_steady_bones_unless_free(truths: Float[ndarray, "120 18 3"]) -> None:
    poses = stream(truths[:1] + np.random.default_rng(3).normal(0, 0.01, truths.shape))
    for name in ("kalman", "fixed-lag"):
        spread = {}
        for bones in ("free", "steady"):
            filter_ = load_filter(name, bones=bones)
            constrained = [*map(filter_, poses), *filter_.finish()][filter_.delay_frames :]
            assert [pose.timestamp_ns for pose in constrained] == [pose.timestamp_ns for pose in poses]
            spread[bones] = lengths(np.stack([pose.joints for pose in constrained])[60:]).std(0).mean()
            assert (filter_.describe()["bones"] is None) == (bones == "free")
        assert spread["steady"] < 0.4 * spread["free"]


def test_bad_settings() -> None:
    for bad in ({"half_life_s": 0.0}, {"unsure": 0.5}):
        with pytest.raises(InputError, match="bones"):
            BoneLengthSettings(**bad)
