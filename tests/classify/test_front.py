"""Labels that take a back for a front are turned round, and how sure that is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from depthmocap.body.regions import TURNED
from depthmocap.body.skeleton import JOINT_INDEX, MIRROR, SIDED
from depthmocap.body.trunk import front_of_trunk
from depthmocap.classify import classifier as module
from depthmocap.classify.classifier import Classifier, packaged_weights
from depthmocap.classify.front import CONCENTRATION, DIRECTIONS, FrontNetwork, front_of_labels, log_odds
from depthmocap.classify.window import Window, make_window
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.pose.cloud import merge_views
from depthmocap.pose.estimators import load_estimator
from depthmocap.pose.labelled_view import LabelledView
from depthmocap.synth.sample import BENCH, Sample, Sampler


@pytest.fixture(scope="module")
def samples(body_model) -> list[Sample]:
    draw = Sampler(BENCH["cut thighs"], seed=3)
    return [draw(i) for i in range(4)]


def _scores(front: np.ndarray) -> np.ndarray:
    """Scores of a network that is sure of a front."""
    return CONCENTRATION * DIRECTIONS @ front


def _window(view: View) -> Window:
    assert view.mask is not None
    window = make_window(view.depth_m, view.mask, view.camera)
    assert window is not None
    return window


def test_odds_tell_a_front_from_its_opposite() -> None:
    front = np.array([0.6, 0.0, -0.8])
    assert log_odds(_scores(front), front) > 5
    assert log_odds(_scores(front), -front) == pytest.approx(-log_odds(_scores(front), front))
    assert log_odds(np.zeros(64), front) == pytest.approx(0, abs=0.2)  # nothing is known
    assert np.isnan(log_odds(_scores(front), np.full(3, np.nan)))


def test_true_labels_and_joints_imply_one_front_and_turned_labels_the_other(samples: list[Sample]) -> None:
    for sample, view in ((each, view) for each in samples for view in each.views):
        window = _window(view)
        assert view.labels is not None
        labels = np.where(window.inputs[1] > 0, window.labels_from_image(view.labels), 0)
        labels[labels == 255] = 0
        joints = window.positions_from_world(sample.joints, view.camera)
        front = front_of_trunk(joints[None])[0]
        implied = front_of_labels(window, labels, joints)
        if np.isnan(implied).any():  # one side is hidden
            continue
        assert implied @ front > 0.3
        assert front_of_labels(window, TURNED[labels], joints) @ front < -0.3
        assert np.isnan(front_of_labels(window, np.zeros_like(labels), joints)).all()


def test_the_packaged_network_knows_fronts(samples: list[Sample]) -> None:
    network = FrontNetwork()
    odds = []
    for sample in samples:
        for view in sample.views:
            window = _window(view)
            front = front_of_trunk(window.positions_from_world(sample.joints, view.camera)[None])[0]
            odds.append(log_odds(network(window), front))
    assert np.mean(np.array(odds) > 0) > 0.9
    assert np.median(odds) > 2


def test_labels_are_turned_where_the_odds_say_so(samples: list[Sample], monkeypatch: pytest.MonkeyPatch) -> None:
    view = samples[0].views[0]
    assert view.mask is not None
    monkeypatch.setattr(module, "_SURE_OF_FRONT", 2.0)
    monkeypatch.setattr(module, "_FEWEST_LOWER_LEGS", 2.0)  # as of somebody cut off
    plain = Classifier(threads=1, fronts=False).label_mask(view, view.mask)
    assert plain.window is not None
    assert plain.window_prediction is not None
    assert np.isnan(plain.prediction.front_log_odds)
    implied = front_of_labels(plain.window, plain.window_prediction.labels, plain.window_prediction.joints[:, :3])
    for sign in (1, -1):
        monkeypatch.setattr(module, "FrontNetwork", lambda sign=sign: lambda window: _scores(sign * implied))
        given = Classifier(threads=1).label_mask(view, view.mask).prediction
        assert given.front_log_odds > 5
        labels, joints = plain.prediction.labels, plain.prediction.joints
        np.testing.assert_array_equal(given.labels, labels if sign > 0 else TURNED[labels])
        np.testing.assert_allclose(given.joints, joints if sign > 0 else joints[MIRROR])


def test_sure_labels_and_whole_people_are_not_asked_about(
    samples: list[Sample], monkeypatch: pytest.MonkeyPatch
) -> None:
    def asked(window: Window) -> np.ndarray:
        raise AssertionError

    monkeypatch.setattr(module, "FrontNetwork", lambda: asked)
    view = samples[0].views[0]
    assert view.mask is not None
    monkeypatch.setattr(module, "_SURE_OF_FRONT", 2.0)
    with monkeypatch.context() as whole:
        whole.setattr(module, "_FEWEST_LOWER_LEGS", 0.0)
        whole.setattr(module, "_LEAST_FACING", 0.0)
        assert np.isnan(Classifier(threads=1).label_mask(view, view.mask).prediction.front_log_odds)
    rows = np.flatnonzero(view.mask.any(1))
    upper_half = view.mask.copy()
    upper_half[(rows[0] + rows[-1]) // 2 :] = False
    with pytest.raises(AssertionError):
        Classifier(threads=1).label_mask(view, upper_half)
    monkeypatch.setattr(module, "_SURE_OF_FRONT", 0.0)
    assert Classifier(threads=1).label_mask(view, upper_half).prediction.front_log_odds == 5


def test_sides_that_are_not_known_are_told(samples: list[Sample]) -> None:
    view = samples[0].views[0]
    assert view.labels is not None
    weights = np.where(view.labels > 0, 0.9, 0).astype(np.float32)
    estimator = load_estimator("votes")
    _, sure = estimator(merge_views([LabelledView(view, view.labels, weights)]))
    _, doubtful = estimator(merge_views([LabelledView(view, view.labels, weights, front_log_odds=0.0)]))
    np.testing.assert_allclose(doubtful[SIDED], sure[SIDED] / 2)
    np.testing.assert_allclose(doubtful[JOINT_INDEX["Neck"]], sure[JOINT_INDEX["Neck"]])
    # Two views that agree are surer than one.
    one, two = (merge_views([LabelledView(view, view.labels, weights, front_log_odds=1.0)] * n) for n in (1, 2))
    assert two.front_log_odds == 2 * one.front_log_odds == 2.0


def test_another_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not tell fronts"):
        FrontNetwork(packaged_weights())
    with pytest.raises(InputError, match=r"front\.onnx"):
        FrontNetwork(tmp_path / "front.onnx")
