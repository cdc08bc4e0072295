"""People, cameras and training batches in torch, on CPU tensors."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from depthmocap.body.model import REST_POSTURE, Body, BodyModel
from depthmocap.errors import InputError
from depthmocap.geometry import DepthCamera
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.bodies import random_dressed
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import Layer, Material, PosedPerson

torch = pytest.importorskip("torch")

from depthmocap.synth.gpu.torch_bank import BodiesInPostures, BodyBank, PosedPeople, RestLayer, rest_layers  # noqa: E402
from depthmocap.synth.gpu.torch_source import TorchSynth, TorchSynthSettings, random_poses  # noqa: E402


def shells(body: Body, kind: int) -> list[RestLayer]:
    """What a body wears: nothing, a shell, or two; the second follows one bone alone."""
    model = body.model
    rest = (body.rest_vertices * 1.01).astype(np.float32)
    shell = RestLayer(Layer(rest, model.faces[::2], Material.CLOTH), model.skin_indices, model.skin_weights)
    head = model.bone_names.index("head")
    hat = RestLayer(Layer(rest[:300] + np.float32(0.1), np.arange(300).reshape(-1, 3), Material.HAIR),
                    np.full((300, 1), head), np.ones((300, 1), np.float32))  # fmt: skip
    return [[], [shell], [shell, hat]][kind]


@pytest.fixture(scope="module")
def bank(default_body: Body) -> BodyBank:
    bodies = [
        default_body,
        default_body.with_vertices(default_body.rest_vertices + np.float32(0.01)),
        default_body.with_vertices(default_body.rest_vertices * np.float32(0.97)),
    ]
    return BodyBank.of(bodies, [shells(body, i) for i, body in enumerate(bodies)])


def test_bank_poses_what_bodies_wear(bank: BodyBank, default_body: Body, body_model: BodyModel) -> None:
    rng = np.random.default_rng(4)
    chosen = [2, 0, 1, 2]
    postures = np.stack([PosturePrior.load().sample(rng)[0] for _ in chosen])
    vertices, layers = bank.pose(torch.tensor(chosen), torch.from_numpy(postures))
    assert layers is not None
    for i, (which, posture) in enumerate(zip(chosen, postures, strict=True)):
        body = default_body.with_vertices(bank.rest_vertices[which].numpy())
        transforms = default_body.bone_transforms(posture)
        np.testing.assert_allclose(vertices[i].numpy(), body.pose(posture).vertices, atol=5e-6)
        own = layers.vertices[layers.picture_of_vertex == i].numpy()
        worn = shells(body, which)
        expected = [
            transforms.skin(layer.layer.vertices, layer.skin_indices.astype(np.int32), layer.skin_weights)
            for layer in worn
        ]
        np.testing.assert_allclose(own, np.concatenate([np.zeros((0, 3)), *expected]), atol=1e-5)
        # Faces, too: corners of every triangle in its order.
        corners = layers.vertices[layers.faces[layers.picture_of_face == i]].numpy()
        meshes = [points[layer.layer.faces] for points, layer in zip(expected, worn, strict=True)]
        np.testing.assert_allclose(corners, np.concatenate([np.zeros((0, 3, 3)), *meshes]), atol=1e-5)
        materials = [np.full(len(layer.layer.faces), layer.layer.material) for layer in worn]
        np.testing.assert_array_equal(
            layers.materials[layers.picture_of_face == i].numpy(), np.concatenate([np.zeros(0), *materials])
        )


@pytest.fixture(scope="module")
def dressed(body_model: BodyModel) -> list[DressedBody]:
    rng = np.random.default_rng(8)
    return [random_dressed(rng, "open") for _ in range(3)]


def test_clothes_go_with_the_body(dressed: list[DressedBody]) -> None:
    bank = BodyBank.of([one.body for one in dressed], [rest_layers(one) for one in dressed])
    rng = np.random.default_rng(9)
    for posture, most_m, median_m in (
        (REST_POSTURE, 1e-5, 1e-6),
        (PosturePrior.load().sample(rng)[0], 0.3, 0.008),
        (PosturePrior.load().sample(rng)[0], 0.3, 0.008),
    ):
        _, layers = bank.pose(torch.arange(3), torch.from_numpy(np.stack([posture] * 3)))
        assert layers is not None
        for i, one in enumerate(dressed):
            expected = np.concatenate([layer.vertices for layer in one.pose(posture).layers])
            got = layers.vertices[layers.picture_of_vertex == i].numpy()
            away = np.linalg.norm(got - expected, axis=1)
            assert away.max() < most_m
            assert np.median(away) < median_m


def test_people_posed_beforehand(dressed: list[DressedBody]) -> None:
    rng = np.random.default_rng(10)
    people = [one.pose(PosturePrior.load().sample(rng)[0]) for one in dressed]
    people[1] = PosedPerson(people[1].body)
    source = PosedPeople.of(people)
    vertices, layers = source.draw(9, torch.Generator().manual_seed(0))
    assert layers is not None
    drawn = set()
    for i in range(9):
        which = next(k for k, person in enumerate(people) if np.array_equal(person.vertices, vertices[i].numpy()))
        drawn.add(which)
        corners = layers.vertices[layers.faces[layers.picture_of_face == i]].numpy()
        meshes = [layer.vertices[layer.faces] for layer in people[which].layers]
        np.testing.assert_array_equal(corners, np.concatenate([np.zeros((0, 3, 3)), *meshes]))
    assert drawn == {0, 1, 2}
    x, y = TorchSynth(source, SENSORS, dataclasses.replace(SETTINGS, occlude=0.0)).batch(0)
    mask = x[:, 1] > 0
    assert (mask.flatten(1).sum(1) > 500).sum() >= 6
    assert (y[mask] != 255).float().mean() > 0.6


SETTINGS = TorchSynthSettings(batch=8)


SENSORS = [DepthCamera("fine", 512, 424, 366.0, 366.0, 256.0, 212.0),
           DepthCamera("coarse", 320, 240, 285.0, 285.0, 160.0, 120.0)]  # fmt: skip


@pytest.fixture(scope="module")
def crowd(bank: BodyBank) -> BodiesInPostures:
    return BodiesInPostures.of(bank, PosturePrior.load(), 20, np.random.default_rng(1))


def source(crowd: BodiesInPostures, settings: TorchSynthSettings = SETTINGS, seed: int = 0) -> TorchSynth:
    return TorchSynth(crowd, SENSORS, settings, seed)


def test_batches(crowd: BodiesInPostures) -> None:
    made = source(crowd)
    (x, y), (x1, _) = itertools.islice(made.batches(first=3), 2)
    assert (x.shape, y.shape) == ((8, 3, 192, 192), (8, 192, 192))
    assert (x.dtype, y.dtype) == (torch.float32, torch.uint8)
    assert x.isfinite().all()
    mask = x[:, 1] > 0
    assert (mask.flatten(1).sum(1) > 500).sum() >= 6
    assert ((y >= 1) & (y <= 43) | (y == 255)).all()
    assert ((y[mask] != 255).float().mean()) > 0.6
    assert len(y.unique()) > 30
    # A batch is of its number and the seed alone.
    again, again_labels = source(crowd).batch(3)
    assert torch.equal(x, again)
    assert torch.equal(y, again_labels)
    assert not torch.equal(x, x1)
    assert not torch.equal(x, source(crowd, seed=1).batch(3)[0])


def test_size_without_noise(crowd: BodiesInPostures) -> None:
    plain = TorchSynthSettings(batch=6, window=250, person=190, truncate=0.0, occlude=0.0, noise=None)
    x, y = source(crowd, plain).batch(0)
    assert x.shape == (6, 3, 250, 250)
    mask = x[:, 1] > 0
    extent = torch.stack([mask.any(1).sum(1), mask.any(2).sum(1)]).amax(0)
    assert ((extent >= 186) & (extent <= 191)).all()
    occluded, _ = source(crowd, dataclasses.replace(plain, occlude=1.0)).batch(0)
    # A part of most people is gone.
    assert ((occluded[:, 1] != x[:, 1]).flatten(1).sum(1) > 50).sum() >= 3
    assert y.max() == 255


def test_windows_of_nobody_teach_nothing(crowd: BodiesInPostures) -> None:
    lost = TorchSynthSettings(batch=8, truncate=1.0, truncated_aim_m=50.0)
    x, y = source(crowd, lost).batch(0)
    empty = ~(x[:, 1] > 0).flatten(1).any(1)
    assert empty.sum() >= 4
    assert not x[empty].any()
    assert (y[empty] == 255).all()


def test_cameras_look_at_people(default_body: Body) -> None:
    rng = np.random.default_rng(3)
    people = [default_body.pose(PosturePrior.load().sample(rng)[0]) for _ in range(5)]
    vertices = torch.from_numpy(np.stack([person.vertices for person in people] * 40))
    settings = TorchSynthSettings(truncate=0.0)
    pose = random_poses(vertices, settings, torch.Generator().manual_seed(0)).numpy()
    rotation, translation = pose[:, :, :3], pose[:, :, 3]
    np.testing.assert_allclose(rotation @ rotation.swapaxes(1, 2), np.tile(np.eye(3), (200, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(rotation), 1, atol=1e-9)
    low, high = vertices.amin(1).numpy(), vertices.amax(1).numpy()
    centre = (rotation @ ((low + high) / 2)[:, :, None])[:, :, 0] + translation
    assert ((centre[:, 2] > 1.1) & (centre[:, 2] < 4.6)).all()
    assert np.abs(centre[:, :2] / centre[:, 2:]).max() < 0.4
    assert (rotation[:, 1, 2] < -0.3).all()  # the picture's y points down
    eye = -(rotation.swapaxes(1, 2) @ translation[:, :, None])[:, :, 0]
    height = eye[:, 2] - low[:, 2]
    assert ((height > 0.2 - 1e-6) & (height < 2.8 + 1e-6)).all()
    side = np.arctan2(eye[:, 0], -eye[:, 1])
    assert np.histogram(side, 4, (-np.pi, np.pi))[0].min() > 30


def test_bad_settings(crowd: BodiesInPostures, default_body: Body) -> None:
    with pytest.raises(InputError, match="distance_m"):
        TorchSynthSettings(distance_m=(4.0, 1.0))
    with pytest.raises(InputError, match="person"):
        TorchSynthSettings(window=100, person=120)
    with pytest.raises(InputError, match="batch"):
        TorchSynthSettings(batch=0)
    with pytest.raises(InputError, match="at least one camera"):
        TorchSynth(crowd, [])
    with pytest.raises(InputError, match="at least one body"):
        BodyBank.of([])
    with pytest.raises(InputError, match="at least one posture"):
        BodiesInPostures.of(crowd.bank, PosturePrior.load(), 0, np.random.default_rng(0))
    with pytest.raises(InputError, match="at least one person"):
        PosedPeople.of([])
    with pytest.raises(InputError, match="one list of layers"):
        BodyBank.of([default_body], [])
