"""The data card: its numbers are those of samples known by construction."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray

from depthmocap.body.skeleton import JOINT_INDEX
from depthmocap.datasets.ubc3v import kinect2_camera
from depthmocap.frames import View
from depthmocap.geometry import look_at
from depthmocap.synth.sample import Sample
from depthmocap.synth.writing.card import POSTURE_KINDS, card_stride, describe, posture_kinds, summary, write_card

STANDING = {
    "Head": (0, 0, 1.6), "Neck": (0, 0, 1.5), "Spine2": (0, 0, 1.4), "Spine1": (0, 0, 1.2), "Spine": (0, 0, 1.1),
    "Hip": (0, 0, 1.0), "RHip": (-0.1, 0, 0.9), "RKnee": (-0.1, 0, 0.5), "RFoot": (-0.1, 0, 0.1),
    "LHip": (0.1, 0, 0.9), "LKnee": (0.1, 0, 0.5), "LFoot": (0.1, 0, 0.1), "RShoulder": (-0.2, 0, 1.5),
    "RElbow": (-0.2, 0, 1.2), "RHand": (-0.2, 0, 0.9), "LShoulder": (0.2, 0, 1.5), "LElbow": (0.2, 0, 1.2),
    "LHand": (0.2, 0, 0.9),
}  # fmt: skip


def skeleton(**moved: tuple[float, float, float]) -> Float[ndarray, "18 3"]:
    joints = np.zeros((len(JOINT_INDEX), 3))
    for name, place in (STANDING | moved).items():
        joints[JOINT_INDEX[name]] = place
    return joints


def sample(eyes: list[tuple[float, float, float]], joints: Float[ndarray, "18 3"] | None = None) -> Sample:
    """Seen from each eye: rows 100 to 199 and columns 50 to 69 at 2 m, half region 5 and half region 9."""
    views = []
    for i, eye in enumerate(eyes):
        labels = np.zeros((424, 512), np.uint8)
        labels[100:200, 50:60], labels[100:200, 60:70] = 5, 9
        depth = np.where(labels > 0, np.float32(2.05), np.float32(0))
        camera = kinect2_camera(f"Cam{i + 1}", look_at(np.array(eye, dtype=float), np.array([0.0, 0.0, 1.0])))
        views.append(View(camera, depth, labels > 0, labels))
    return Sample(tuple(views), skeleton() if joints is None else joints, 0)


def test_postures_are_told_apart() -> None:
    lie = skeleton() @ np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    bow = skeleton(Neck=(0, -0.4, 1.4), Head=(0, -0.5, 1.4))
    sit = skeleton(Hip=(0, 0.3, 0.5), RHip=(-0.1, 0.3, 0.4), LHip=(0.1, 0.3, 0.4), Neck=(0, 0.3, 1.0))
    wave = skeleton(LHand=(0.3, 0, 1.9))
    step = skeleton(RFoot=(-0.1, -0.5, 0.2), LFoot=(0.1, 0.3, 0.2))
    kinds = posture_kinds(np.stack([lie, bow, sit, wave, step, skeleton()]))
    assert [POSTURE_KINDS[kind] for kind in kinds] == list(POSTURE_KINDS)


def test_numbers_of_known_samples() -> None:
    # Rest faces −Y: from the front, the subject's left (+X), behind, and from above in front.
    known = sample([(0, -2, 1.0), (3, 0, 1.0), (0, 4, 1.0), (0, -2, 3.0)])
    row = describe(0, known, 1)
    assert row is not None
    numbers = summary([row])
    assert numbers["azimuth_share"] == {"front": 0.5, "left": 0.25, "back": 0.25, "right": 0.0}
    assert numbers["distance_m"]["p95"] <= 4.0
    np.testing.assert_allclose(sorted(row.views[:, 0]), [2, np.sqrt(8), 3, 4])
    np.testing.assert_allclose(row.views[:, 2], [0, 0, 0, 45], atol=1e-9)
    shares = {name: share for name, share in numbers["region_pixel_share"].items() if share}
    assert list(shares.values()) == [0.5, 0.5]
    assert list(numbers["region_pixel_share"]).index(next(iter(shares))) == 4
    assert numbers["person_px"]["p50"] == 2000
    assert numbers["person_rows_px"]["p50"] == 100
    assert numbers["depth_m"] == {"p5": 2.0, "p50": 2.0, "p95": 2.0}
    assert numbers["views_cut_off"] == numbers["person_pixels_without_depth"] == 0
    assert numbers["stature_to_skull_m"]["p50"] == pytest.approx(1.4)


def test_what_is_lost_is_counted() -> None:
    known = sample([(0, -2, 1.0), (0, -2, 1.0)])
    first, second = known.views
    assert first.labels is not None
    assert second.mask is not None
    first.depth_m[100:150] = 0  # half of the person
    second.mask[0, 50:70] = True  # worn things up to the border: 20 pixels without a label, nor depth
    row = describe(0, known, 1)
    assert row is not None
    numbers = summary([row])
    assert numbers["views_cut_off"] == 0.5
    assert numbers["person_pixels_without_depth"] == pytest.approx((0.5 + 20 / 2020) / 2, abs=1e-4)
    assert numbers["person_pixels_unlabelled"] == pytest.approx(20 / 2020 / 2, abs=1e-4)


def test_headings_do_not_spread_postures() -> None:
    angles = np.linspace(0, 6, 9)
    turned = [skeleton() @ np.array([[np.cos(a), np.sin(a), 0], [-np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in angles]
    rows = [describe(i, sample([(0, -2, 1)], joints), 9) for i, joints in enumerate(turned)]
    numbers = summary([row for row in rows if row is not None])
    assert max(numbers["joint_deviation_m"].values()) < 1e-4
    assert numbers["nearest_posture_rms_m"]["p95"] < 1e-4
    raised = describe(0, sample([(0, -2, 1)], skeleton(LHand=(0.2, 0, 1.4))), 1)
    upright = describe(0, sample([(0, -2, 1)]), 1)
    assert raised is not None
    assert upright is not None
    assert summary([raised, upright])["nearest_posture_rms_m"]["p50"] == pytest.approx(0.5 / np.sqrt(18), abs=1e-4)


def test_the_cost_is_bounded_and_growing_keeps_rows() -> None:
    for samples in (1, 1000, 1024, 1025, 5000, 2_000_000):
        stride = card_stride(samples)
        assert len(range(0, samples, stride)) <= 1024
        assert stride == 1 or len(range(0, samples, stride)) > 512
        assert card_stride(4 * samples) % stride == 0
    assert describe(3, sample([(0, -2, 1)]), 5000) is None
    pictures = sum(
        row.picture is not None for i in range(40) if (row := describe(i, sample([(0, -2, 1)]), 40)) is not None
    )
    assert 8 <= pictures < 16


def test_card_files(tmp_path: Path) -> None:
    rows = [row for i in range(3) if (row := describe(i, sample([(0, -2, 1), (0, 2, 1)]), 3)) is not None]
    write_card(tmp_path, "easy-pose/test", {"seed": 7, "samples": 3, "recipe": {"views": 2}}, rows)
    card = json.loads((tmp_path / "card.json").read_text())
    assert (card["seed"], card["samples"], card["described_views"]) == (7, 3, 6)
    page = (tmp_path / "card.html").read_text()
    assert page.count("<img") == 4
    assert "easy-pose/test" in page
    assert not list(tmp_path.glob("*.part"))
