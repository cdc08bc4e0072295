"""Training of the network that finds people, at a small scale."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnxscript")
from safetensors.torch import load_file  # noqa: E402

from depthmocap.errors import InputError  # noqa: E402
from depthmocap.geometry import DepthCamera  # noqa: E402
from depthmocap.segment.people_detector import PeopleDetector, grid_of  # noqa: E402
from depthmocap.synth.body.mesh import BodyModel  # noqa: E402
from depthmocap.train.people_network import PeopleNet  # noqa: E402
from depthmocap.train.people_samples import IGNORED, PICTURE, PeopleScenes  # noqa: E402
from depthmocap.train.train_people import PeopleTraining, mirrored, people_loss, train_people  # noqa: E402


@pytest.fixture(scope="module")
def examples(body_model: BodyModel):
    scenes = PeopleScenes(None, "train", 3)
    return [example for i in range(3) for example in scenes(i)]


def test_examples_tell_people_and_their_centres(examples) -> None:
    assert len(examples) >= 30
    assert any(((example.people > 0) & (example.people < 255)).any() for example in examples)
    for example in examples:
        assert example.inputs.shape[1:] == PICTURE
        assert np.isfinite(example.inputs).all()
        # Samples without depth are not taught.
        empty = example.inputs[0] == 0
        assert (example.people.reshape(PICTURE[0], 2, PICTURE[1], 2).transpose(0, 2, 1, 3)[empty] == IGNORED).all()
        known = np.isfinite(example.offsets[0])
        assert np.abs(example.offsets[:, known]).max(initial=0) <= 2.5
        # Who has a centre is a person.
        cells = ((example.people > 0) & (example.people < 255)).reshape(PICTURE[0], 2, PICTURE[1], 2).any((1, 3))
        assert cells[known].all()


def test_the_mirror_image_is_that_of_the_mirrored_picture(examples) -> None:
    example = max(examples, key=lambda example: int(((example.people > 0) & (example.people < 255)).sum()))
    other = mirrored(example)
    assert (other.people == example.people[:, ::-1]).all()
    assert np.nanmax(np.abs(other.offsets[0] + example.offsets[0][:, ::-1])) == 0
    assert (other.inputs[2] == example.inputs[3][:, ::-1]).all()
    assert (other.inputs[6] == -example.inputs[6][:, ::-1]).all()
    twice = mirrored(other)
    assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(twice, example, strict=True))


def test_the_loss_is_least_at_the_truth_and_ignores_what_is_unknown() -> None:
    people = torch.tensor([[[1, 0], [IGNORED, 0]]], dtype=torch.uint8)
    offsets = torch.tensor([0.1, 0.2, 0.3]).reshape(1, 3, 1, 1)
    right = torch.cat([torch.tensor([9.0, -9.0, 5.0, -9.0]), torch.tensor([0.1, 0.2, 0.3])]).reshape(1, 7, 1, 1)
    labels, centres = people_loss(right, people, offsets)
    assert labels.item() < 1e-3
    assert centres.item() == pytest.approx(0.01, abs=1e-3)
    wrong = right.clone()
    wrong[0, 2] = -50  # ignored
    assert people_loss(wrong, people, offsets)[0].item() == pytest.approx(labels.item())
    wrong[0, 0] = -9
    assert people_loss(wrong, people, offsets)[0].item() > 2
    nobody = torch.full_like(offsets, torch.nan)
    assert people_loss(right, people, nobody)[1].item() == 0


def test_a_small_person_counts_for_more_than_their_samples() -> None:
    people = torch.zeros((1, 40, 40), dtype=torch.uint8)
    people[0, :20] = 1
    people[0, 30:34, :4] = 2
    logits = torch.where(people == 1, 9.0, -9.0)  # the small one is overlooked
    outputs = torch.cat([torch.nn.functional.pixel_unshuffle(logits[:, None], 2), torch.zeros((1, 3, 20, 20))], 1)
    loss = people_loss(outputs, people, torch.full((1, 3, 20, 20), torch.nan))[0].item()
    assert loss == pytest.approx(3 * 9 * 16 / 1600, rel=0.02)


def settings_of(folder: Path, images: int) -> PeopleTraining:
    return PeopleTraining(folder, images=images, batch=8, workers=0, valid_every=16, valid_scenes=1, average=0.5)


def draw_few_scenes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Batches of one scene each, for scenes take longer to make than steps."""
    monkeypatch.setattr("depthmocap.train.train_people._RANGE_BATCHES", 1)
    monkeypatch.setattr("depthmocap.train.train_people._MIXED", 0)


@pytest.mark.slow
def test_a_run_trains_and_resumes(body_model: BodyModel, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[dict[str, str]] = []

    def export(network: PeopleNet, path: Path, metadata: dict[str, str], pictures: list[np.ndarray]) -> Path:
        assert len(pictures) == 8
        told.append(metadata)
        return path

    draw_few_scenes(monkeypatch)
    monkeypatch.setattr("depthmocap.train.train_people.export_people_onnx", export)  # which takes longer than the rest
    for images in (16, 24):
        train_people(settings_of(tmp_path / "run", images))
    assert told == [{"images": "16"}, {"images": "24"}]
    rows = [json.loads(row) for row in (tmp_path / "run" / "history.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [16, 24]
    assert all(np.isfinite(row["loss"]) and 0 <= row["iou"] <= 1 for row in rows)
    PeopleNet().load_state_dict(load_file(tmp_path / "run" / "people.safetensors"))


@pytest.mark.slow
def test_a_run_exports_what_the_detector_reads(examples, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    draw_few_scenes(monkeypatch)
    network = train_people(settings_of(tmp_path / "run", 16))
    detected = PeopleDetector(network)(
        grid_of(DepthCamera("c", 256, 212, 182.0, 182.0, 127.5, 105.5), np.array([0.0, 0.0, 1.0])),
        np.full((212, 256), 2.0, np.float32),
    )
    assert np.isfinite(detected.logits).all()
    # The exported network is the trained one, in 8 bits.
    trained = PeopleNet().eval()
    trained.load_state_dict(load_file(tmp_path / "run" / "people.safetensors"))
    pictures = np.stack([example.inputs for example in examples[:6]])
    with torch.no_grad():
        exact = trained(torch.from_numpy(pictures)).numpy()
    exported = np.asarray(onnxruntime.InferenceSession(network).run(None, {"cells": pictures})[0])
    assert np.corrcoef(exported[:, :4].ravel(), exact[:, :4].ravel())[0, 1] > 0.99


def test_checkpoints_and_starts_that_cannot_be(tmp_path: Path) -> None:
    torch.save({"history": "[]", "done": 16, "spent": 1.0}, tmp_path / "checkpoint.pt")
    with pytest.raises(InputError, match=r"checkpoint\.pt is of another network or optimiser"):
        train_people(PeopleTraining(tmp_path))
    with pytest.raises(InputError, match="--start must not be a file that training writes"):
        train_people(PeopleTraining(tmp_path, start=tmp_path / "people.safetensors"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"batch": 0}, "--batch"),
        ({"learning_rate": -1.0}, "--learning-rate"),
        ({"minutes": -1.0}, "--minutes"),
        ({"average": 1.0}, "--average"),
    ],
)
def test_settings_that_cannot_be(change: dict, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        PeopleTraining(tmp_path, **change)
