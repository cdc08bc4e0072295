import dataclasses

import numpy as np
import pytest

from depthmocap.body.skeleton import JOINTS
from depthmocap.errors import InputError
from depthmocap.pose.features import FEATURE_COUNT, FeatureFrame
from depthmocap.pose.ridge import RidgeBank, RidgePose, fit_ridge, grouped_folds

USED = 30


def make_data(rng, n=200, noise=0.0):
    """Features of which the first few are used, and joints linear in them."""
    features = np.zeros((n, FEATURE_COUNT), np.float32)
    features[:, :USED] = rng.standard_normal((n, USED)) * rng.uniform(0.01, 2, USED) + 1
    joints = features[:, :USED] @ rng.standard_normal((USED, 54)) * 0.2 + 0.4
    joints = joints + noise * rng.standard_normal(joints.shape)
    return features, joints.reshape(n, 18, 3), np.arange(n) // 10


def make_model(rng, views=0, frame: FeatureFrame = "cloud"):
    halves = (rng.standard_normal((FEATURE_COUNT, 54)) * 0.01).astype(np.float16)
    mean, scale = rng.standard_normal((2, FEATURE_COUNT)).astype(np.float32)
    bias = rng.standard_normal(54).astype(np.float32)
    weights = halves.astype(np.float32)
    return RidgePose(mean, np.abs(scale) + 1, weights, bias, 3.0, JOINTS, frame, views, "network")


def test_recovers_a_linear_map():
    rng = np.random.default_rng(0)
    features, joints, groups = make_data(rng)
    model = fit_ridge(features[:150], joints[:150], groups[:150], strengths=[1e-4])
    np.testing.assert_allclose(model.predict(features[150:]), joints[150:], atol=2e-3)  # weights may be 16 bits


def test_is_the_minimum_of_the_objective():
    rng = np.random.default_rng(1)
    features, joints, groups = make_data(rng, noise=0.1)
    model = fit_ridge(features, joints, groups, strengths=[50.0])
    x = (features - model.mean) / model.scale
    misses = model.predict(features).reshape(-1, 54) - joints.reshape(-1, 54)
    # The gradients with respect to the weights and the bias vanish.
    np.testing.assert_allclose(x.T @ misses + 50.0 * model.weights, 0, atol=0.05)
    np.testing.assert_allclose(misses.mean(0), 0, atol=1e-5)


def test_cross_validation_chooses_by_noise():
    rng = np.random.default_rng(2)
    strengths = np.logspace(-3, 5, 9)
    clean = fit_ridge(*make_data(rng, 100), strengths, folds=3)
    noisy = fit_ridge(*make_data(rng, 100, noise=3.0), strengths, folds=3)
    assert clean.strength == strengths[0]
    assert clean.strength < noisy.strength


def test_groups_keep_copies_out_of_validation():
    # Each clip is one posture many times over: with clips split, the weakest strength would look best.
    rng = np.random.default_rng(3)
    features, joints, _ = make_data(rng, 40, noise=3.0)
    features, joints, groups = (np.repeat(x, 10, axis=0) for x in (features, joints, np.arange(40)))
    strengths = np.logspace(-3, 5, 9)
    grouped = fit_ridge(features, joints, groups, strengths, folds=3)
    split = fit_ridge(features, joints, np.arange(400) % 10, strengths, folds=3)
    assert split.strength < grouped.strength


def test_folds_are_disjoint_and_even():
    groups = np.random.default_rng(4).integers(0, 37, 1000)
    fold_of = grouped_folds(groups, 5)
    assert all(len(set(fold_of[groups == group])) == 1 for group in range(37))
    sizes = np.bincount(fold_of, minlength=5)
    assert sizes.min() > 150
    assert set(grouped_folds(np.array([4, 4, 9]), 5)) == {0, 1}
    with pytest.raises(InputError, match="two groups"):
        grouped_folds(np.zeros(5, int), 5)


def test_unseen_features_count_as_the_training_mean():
    rng = np.random.default_rng(5)
    features, joints, groups = make_data(rng)
    features[::3, 2] = np.nan
    features[:, 500] = np.nan  # never seen
    features[:, 501] = 7.1  # always the same
    model = fit_ridge(features, joints, groups, strengths=[1.0])
    np.testing.assert_allclose(model.mean[2], np.nanmean(features[:, 2]), rtol=1e-5)
    filled = features.copy()
    filled[::3, 2] = model.mean[2]
    filled[:, 500] = 123.0
    np.testing.assert_allclose(model.predict(filled), model.predict(features), atol=1e-4)
    nothing = np.full((1, FEATURE_COUNT), np.nan, np.float32)
    np.testing.assert_allclose(model.predict(nothing)[0], joints.mean(0), atol=0.2)


def test_fewer_samples_than_features():
    rng = np.random.default_rng(6)
    features = rng.standard_normal((50, FEATURE_COUNT)).astype(np.float32)
    model = fit_ridge(features, rng.standard_normal((50, 18, 3)), np.arange(50))
    assert np.isfinite(model.predict(features)).all()


def test_bad_training_data_is_refused():
    features, joints, groups = make_data(np.random.default_rng(7), 20)
    with pytest.raises(InputError, match="1032"):
        fit_ridge(features[:, 1:], joints, groups)
    with pytest.raises(InputError, match="positive"):
        fit_ridge(features, joints, groups, [0.0, 1.0])
    with pytest.raises(InputError, match="NaN for regions"):
        fit_ridge(features + np.float32(np.inf), joints, groups)
    joints[3, 4] = np.nan
    with pytest.raises(InputError, match="finite"):
        fit_ridge(features, joints, groups)


def test_wrong_feature_count_is_refused():
    with pytest.raises(InputError, match="got 24"):
        make_model(np.random.default_rng(8)).predict(np.zeros((1, 24), np.float32))


@pytest.mark.parametrize("exact", [True, False])
def test_save_and_load(tmp_path, exact):
    rng = np.random.default_rng(9)
    model = make_model(rng, views=2, frame="world")
    if not exact:  # not representable in 16 bits: written in 32
        model = dataclasses.replace(model, weights=model.weights * np.float32(1.0001))
    model.save(tmp_path / "model.npz")
    again = RidgePose.load(tmp_path / "model.npz")
    for field in dataclasses.fields(model):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(model, field.name))
    assert again.joints == JOINTS
    assert ((tmp_path / "model.npz").stat().st_size < 150_000) == exact


def test_fitted_weights_fit_16_bits():
    features, joints, groups = make_data(np.random.default_rng(10), 50, noise=0.05)
    model = fit_ridge(features, joints * 0.3, groups, strengths=[10.0])  # of the size of a person
    np.testing.assert_array_equal(model.weights.astype(np.float16), model.weights)


def test_bank(tmp_path):
    rng = np.random.default_rng(11)
    one, three, four = (make_model(rng, views) for views in (1, 3, 4))
    bank = RidgeBank((four, one, three))
    assert [bank.model_for(views).views for views in (0, 1, 2, 3, 4, 7)] == [1, 1, 1, 3, 4, 4]
    bank.save(tmp_path / "bank.npz")
    again = RidgeBank.load(tmp_path / "bank.npz")
    features = rng.standard_normal((2, FEATURE_COUNT))
    np.testing.assert_array_equal(again.predict(features, 3), three.predict(features))
    with pytest.raises(InputError, match="3 models"):
        RidgePose.load(tmp_path / "bank.npz")
    with pytest.raises(InputError, match="bank"):
        RidgeBank((one, one))
    with pytest.raises(InputError, match="bank"):
        RidgeBank((one, dataclasses.replace(three, frame="world")))


def test_bad_files_are_refused(tmp_path):
    path = tmp_path / "model.npz"
    with pytest.raises(InputError, match="not found"):
        RidgePose.load(path)
    model = make_model(np.random.default_rng(12))
    model.save(path)
    whole = path.read_bytes()
    for content in (b"", b"text", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(InputError, match="not a pose model"):
            RidgePose.load(path)
    np.savez(path, mean=np.zeros(3))
    with pytest.raises(InputError, match="format"):
        RidgePose.load(path)
    model.save(path)
    np.savez(path, **{**np.load(path), "frame": np.array(["room"])})
    with pytest.raises(InputError, match="frame must be one of world, cloud, body"):
        RidgePose.load(path)
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(InputError, match="not a pose model"):
        RidgePose.load(tmp_path / "array.npy")

    def spoil(**changes):
        path.write_bytes(whole)
        with np.load(path) as archive:
            arrays = dict(archive)
        np.savez(path, **(arrays | changes))

    for changes, message in (
        ({"weights": np.zeros((1, 5, 54))}, r"weights has the shape \(1, 5, 54\): expected \(1, 1032, 54\)"),
        ({"joints": np.array(["Nose"])}, "Nose"),
        ({"bias": np.full((1, 54), np.nan)}, "not finite"),
        ({"views": np.array([1, 2])}, "shape"),
        ({"mean": np.full((1, FEATURE_COUNT), "a")}, "mean has the type <U1"),
        ({"mean": np.full((1, FEATURE_COUNT), None)}, "pickles"),
    ):
        spoil(**changes)
        with pytest.raises(InputError, match=message):
            RidgePose.load(path)


def test_clipping_bounds_what_a_stray_feature_does(tmp_path):
    rng = np.random.default_rng(5)
    features, joints, groups = make_data(rng)
    model = fit_ridge(features, joints, groups, strengths=[1.0], clip=3.0)
    model.save(tmp_path / "model.npz")
    assert RidgePose.load(tmp_path / "model.npz").clip == 3.0
    stray = features[:1].copy()
    stray[0, 0] = 1000.0
    bound = np.linalg.norm(model.weights[0].reshape(18, 3), axis=1).max() * 6
    moved = np.linalg.norm(model.predict(stray) - model.predict(features[:1]), axis=-1)
    assert 0 < moved.max() <= bound + 1e-6
