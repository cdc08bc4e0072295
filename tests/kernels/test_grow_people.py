"""Labels that grow over surfaces before the empty scene."""

import numpy as np
import pytest

from depthmocap.kernels.people_votes import grow_people


def grown(limit_m=4.0, logit=-3.0, samples_m=None):
    """A row of samples 2 cm apart at 2 m, of which the first is labelled."""
    samples = np.full((3, 40), 2.0, np.float32) if samples_m is None else samples_m
    samples[[0, 2]] = 5.0
    labels = np.zeros(samples.shape, np.uint8)
    labels[1, 0] = 7
    limits, logits = np.full_like(samples, limit_m), np.full_like(samples, logit)
    grow_people(samples, limits, logits, -5.0, 0.1, 0.35, 0.01, labels)
    assert not labels[[0, 2]].any()
    return np.count_nonzero(labels[1] == 7)


def test_a_limb_before_the_empty_scene_is_its_owners_up_to_some_distance():
    assert grown() == pytest.approx(1 + 0.35 / 0.02, abs=1.1)


@pytest.mark.parametrize("change", [{"limit_m": 1.9}, {"limit_m": 0.0}, {"logit": -6.0}])
def test_nothing_else_is(change):
    assert grown(**change) == 1


def test_a_step_in_depth_ends_it():
    samples = np.full((3, 40), 2.0, np.float32)
    samples[1, 5:] = 2.3
    assert grown(samples_m=samples) == 5
