"""The refit to a set's joints, on points whose relation is known."""

import numpy as np
import pytest

from depthmocap import InputError
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.evaluate.estimated_frames import EstimatedFrames
from depthmocap.evaluate.protocol import comparable, leave_one_out, measure_estimates
from depthmocap.evaluate.refit import fit_joints
from depthmocap.pose.parts import BodyFrame, yaw_matrix

NAMES = ("Head", "Navel", "RHand", "Tail")
CORRESPONDENCE = {"Head": "Head", "RHand": "RHand"}
#: In the body's frame: ahead of our head; between two joints; our right hand as it is.
AHEAD_M = np.array([0.05, 0.0, 0.02])


def observations(n=60, noise_m=0.0, seed=0):
    rng = np.random.default_rng(seed)
    angle = rng.uniform(-np.pi, np.pi, n)
    turn = yaw_matrix(np.cos(angle), np.sin(angle))
    frame = BodyFrame(rng.uniform(-2, 2, (n, 3)), turn)
    body = rng.normal(0, 0.4, (n, 18, 3))
    centres = rng.normal(0, 0.4, (n, 43, 3))
    centres[rng.random((n, 43)) < 0.3] = np.nan
    truth = np.stack(
        [
            body[:, JOINT_INDEX["Head"]] + AHEAD_M,
            (body[:, JOINT_INDEX["Hip"]] + body[:, JOINT_INDEX["Spine"]]) / 2,
            body[:, JOINT_INDEX["RHand"]],
            np.full((n, 3), np.nan),
        ],
        1,
    )
    return EstimatedFrames(
        "made", NAMES, CORRESPONDENCE, frame.to_world(body), np.full((n, 18), 0.5), frame.to_world(centres), frame,
        frame.to_world(truth + rng.normal(0, noise_m, truth.shape)),
        np.array([f"p{i % 3}" for i in range(n)]), np.array(["walk" if i < n // 2 else "run" for i in range(n)]),
        np.full(n, 5.0),
    )  # fmt: skip


def error_cm(found, estimates):
    return np.linalg.norm(estimates - found.truths, axis=-1) * 100


def test_offsets_and_mixtures_are_found_whichever_way_people_face():
    joint_map = fit_joints(observations(400))
    new = observations(50, seed=1)
    estimates = joint_map(new)
    errors = error_cm(new, estimates)
    assert errors[:, 0].max() < 0.5  # the offset turns with the body
    assert errors[:, 1].mean() < 2  # from our joints alone
    assert errors[:, 2].max() < 0.5
    assert np.isnan(estimates[:, 3]).all() and joint_map.fitted.tolist() == [True, True, True, False]
    assert np.isnan(joint_map.strengths[3]) and (joint_map.strengths[:3] > 0).all()


def test_noise_does_not_spoil_a_joint_that_corresponds():
    """Few noisy frames: the fit keeps to our joint instead of following the noise."""
    joint_map = fit_joints(observations(30, noise_m=0.05))
    new = observations(200, seed=1)
    assert error_cm(new, joint_map(new))[:, 2].mean() < 4


def test_frames_without_anybody_stay_missing():
    found = observations(100)
    nobody = np.arange(100) % 4 == 0
    found.estimates[nobody] = np.nan
    estimates = leave_one_out(found, found.subjects)
    assert np.isnan(estimates[nobody]).all()
    assert np.isfinite(estimates[~nobody][:, :3]).all()
    numbers = measure_estimates(found, estimates)
    assert numbers["frames_without_person"] == 25
    assert numbers["joints_missing"] == 75  # of three joints with a truth
    assert numbers["mean_ap_10cm"] <= 0.75
    assert set(numbers["by_subject"]) == {"p0", "p1", "p2"} and set(numbers["by_action"]) == {"walk", "run"}


def test_people_are_tested_by_a_fit_to_the_others():
    """One person's head is marked elsewhere: their own frames must not tell the fit."""
    found = observations(300)
    theirs = found.subjects == "p0"
    found.truths[theirs, 0, 2] += 0.2
    errors = error_cm(found, leave_one_out(found, found.subjects))
    assert errors[theirs, 0].mean() == pytest.approx(20, abs=1)
    with pytest.raises(InputError, match="only 'p0' is there"):
        leave_one_out(found.rows(theirs), found.subjects[theirs])


def test_without_a_fit_only_joints_that_correspond():
    found = comparable(observations(10), "none")
    assert found.joints == ("Head", "RHand")
    errors = error_cm(found, leave_one_out(found, found.subjects, "none"))
    np.testing.assert_allclose(errors[:, 0], np.linalg.norm(AHEAD_M) * 100)
    np.testing.assert_allclose(errors[:, 1], 0, atol=1e-9)
    assert (found.joint_confidence() == 0.5).all()
    with pytest.raises(InputError, match="pass --refit ridge"):
        comparable(found.only(()), "none")


def test_too_little_to_fit_to():
    with pytest.raises(InputError, match="no joint is known in 10 frames"):
        fit_joints(observations(9))
