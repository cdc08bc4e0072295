"""Training windows made on the fly."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from depthmocap.body.regions import REGION, UNLABELLED
from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.body.trunk import trunk_lean
from depthmocap.classify.window import DEPTH_SCALE_M, PIXEL_M, WINDOW
from depthmocap.errors import InputError
from depthmocap.synth.body.mesh import BodyModel
from depthmocap.synth.motion.postures import TRAINING_VARIATION, LeaningPostures, PosturePrior, Variation, trunk_angle
from depthmocap.synth.sensing.sensors import SENSORS
from depthmocap.train import windows as data
from depthmocap.train.windows import Degradations, training_window

OFTEN = Degradations()
HEAD = [REGION[name] for name in ("forehead", "hair R", "hair L", "face R", "face L")]
NEVER = Degradations(truncate=0.0, cut=0.0, scene=0.0, floor=0.0, occlude=0.0, erode=0.0)


def window(index: int, spoiling: Degradations | None = OFTEN, seed: int = 0) -> data.LabelledWindow:
    postures = PosturePrior.load(variation=TRAINING_VARIATION)
    return training_window(seed, index, "open", postures, spoiling)


@pytest.fixture(scope="module")
def windows(body_model: BodyModel) -> list[data.LabelledWindow]:
    return [window(index) for index in range(24)]


def test_contents(windows: list[data.LabelledWindow]) -> None:
    for inputs, labels, joints in windows:
        assert inputs.shape == (3, *labels.shape)
        assert max(labels.shape) == WINDOW
        assert (inputs.dtype, labels.dtype) == (np.float32, np.uint8)
        assert np.isfinite(inputs).all()
        assert np.isin(labels, [*range(44), UNLABELLED]).all()
        assert set(np.unique(inputs[1])) == {0.0, 1.0}
        assert np.abs(inputs[0]).max() <= 2
        assert not inputs[0][inputs[1] == 0].any()
        assert np.ptp(inputs[2]) == 0
        # The pixels that are learnt from: in the mask, and with a label.
        assert np.count_nonzero((inputs[1] > 0) & (labels != UNLABELLED)) > 80
        assert (joints.shape, joints.dtype) == ((18, 3), np.float32)
        # Joints are where the person is: the head is among the head's pixels, or near them.
        head = np.isin(labels, HEAD) & (inputs[1] > 0)
        if np.count_nonzero(head) > 50:
            pixel_m = PIXEL_M * 2 ** inputs[2, 0, 0]
            rows, columns = np.nonzero(head)
            place = [
                columns.mean() + 0.5 - labels.shape[1] / 2,
                rows.mean() + 0.5 - labels.shape[0] / 2,
                inputs[0][head].mean(),
            ]
            off = joints[JOINT_INDEX["Head"]] - place * np.array([pixel_m, pixel_m, DEPTH_SCALE_M])
            assert np.abs(off).max() < 0.3
    seen = np.unique(np.concatenate([labels.ravel() for _, labels, _ in windows]))
    assert len(seen) > 40


def test_depends_on_seed_and_index_alone(windows: list[data.LabelledWindow]) -> None:
    for index in (17, 3, 17):  # in any order
        for array, same in zip(window(index), windows[index], strict=True):
            np.testing.assert_array_equal(array, same)
    assert not np.array_equal(window(3, seed=1)[1], windows[3][1])
    assert not np.array_equal(windows[4][1], windows[3][1])


def test_who_does_not_stand_is_mostly_seen_upright_too(body_model: BodyModel) -> None:
    """As the classifier turns their windows; the others as cameras see them."""
    tilted = Variation(tilt=1.0)
    postures = PosturePrior.load(variation=tilted)
    leans = np.array([
        trunk_lean(training_window(0, index, "open", postures, NEVER).joints)
        for index in range(0, 40 * data._WINDOWS_PER_PERSON, data._WINDOWS_PER_PERSON)
    ])  # fmt: skip
    upright = (np.abs(leans) < data._LEANING_RAD).mean()
    assert 0.6 < upright < 0.97


def test_a_network_for_leaning_people_sees_nearly_all_of_them_upright(body_model: BodyModel) -> None:
    postures = LeaningPostures(PosturePrior.load(variation=Variation(tilt=0.2)), share=0.9)
    rng = np.random.default_rng(0)
    assert np.mean([trunk_angle(postures.sample(rng)[0]) > 0.6 for _ in range(60)]) > 0.8
    turned = dataclasses.replace(NEVER, upright=0.95)
    leans = np.array([
        trunk_lean(training_window(0, index, "open", postures, turned).joints)
        for index in range(0, 30 * data._WINDOWS_PER_PERSON, data._WINDOWS_PER_PERSON)
    ])  # fmt: skip
    assert (np.abs(leans) < data._LEANING_RAD).mean() > 0.8


@functools.cache
def _windows(degradations: Degradations | None, count: int, step: int = 1) -> list[data.LabelledWindow]:
    """Windows that several tests look at."""
    return [window(index * step, degradations) for index in range(count)]


def _share(spoiling: Degradations | None, label: int, count: int = 24) -> float:
    """Share of a label in the masks of some windows, each of another person: outfits differ far more than views."""
    drawn = _windows(spoiling, count, data._WINDOWS_PER_PERSON)
    return float(np.mean([(labels[inputs[1] > 0] == label).mean() for inputs, labels, _ in drawn]))


def test_floor_beside_the_feet_is_background(body_model: BodyModel) -> None:
    feet = [REGION[f"{part} {side}"] for part in ("ankle", "forefoot") for side in "RL"]
    near = total = 0
    for index in range(16):
        inputs, labels, _ = window(index, dataclasses.replace(NEVER, floor=1.0))
        rows, columns = np.nonzero((labels == 0) & (inputs[1] > 0))
        foot_rows, foot_columns = np.nonzero(np.isin(labels, feet))
        if len(rows) and len(foot_rows):
            apart = np.hypot(rows[:, None] - foot_rows, columns[:, None] - foot_columns).min(1)
            near += np.count_nonzero(apart < 30)
            total += len(rows)
    assert total > 200 and near > 0.5 * total  # the rest is wide clothes


def test_things_and_wide_clothes_are_background(body_model: BodyModel) -> None:
    wide = _share(None, 0)
    assert 0 < wide < 0.1
    assert _share(dataclasses.replace(NEVER, scene=1.0, objects=1.0, second=1.0), 0, 16) > wide + 0.01


def test_what_a_little_cloth_covers_is_not_known(body_model: BodyModel) -> None:
    assert 0.01 < _share(None, UNLABELLED) < 0.25


def test_occlusion_takes_pixels_from_the_mask(body_model: BodyModel) -> None:
    occluded = dataclasses.replace(NEVER, occlude=1.0)

    def hidden(spoiling: Degradations) -> float:
        """Share of the person's labelled pixels that are not in the mask."""
        drawn = _windows(spoiling, 16)
        return float(
            np.mean([(inputs[1][(labels != UNLABELLED) & (labels != 0)] == 0).mean() for inputs, labels, _ in drawn])
        )

    assert hidden(occluded) > hidden(NEVER) + 0.01  # the sensor loses more, but the same in both


def test_truncation_cuts_bodies_off(body_model: BodyModel) -> None:
    def missing(spoiling: Degradations) -> float:
        return float(np.mean([43 - len(np.unique(labels)) for _, labels, _ in _windows(spoiling, 16)]))

    assert missing(dataclasses.replace(NEVER, truncate=1.0)) > missing(NEVER) + 2


def test_nobody_in_view(body_model: BodyModel, monkeypatch: pytest.MonkeyPatch) -> None:
    small = dataclasses.replace(SENSORS["itop"], width=16, height=12, fx=11.0, fy=11.0, cx=8.0, cy=6.0)
    monkeypatch.setattr(data, "random_preset", lambda rng: small)  # too few pixels for anyone
    with pytest.raises(InputError, match=r"no person could be drawn in 20 tries \(seed 5, index 9\)"):
        window(9, seed=5)
