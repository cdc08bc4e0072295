"""Rows of the renderer on a GPU, beside the CPU's on one core; left out with a note where there is no GPU."""

from __future__ import annotations

import numpy as np
import torch
from body_rows import camera_before
from timing import Bench, Reference
from torch import Tensor

from depthmocap.classify.preprocess import make_window
from depthmocap.geometry import DepthCamera
from depthmocap.synth.gpu.torch_bank import BodiesInPostures, BodyBank, PosedPeople, rest_layers
from depthmocap.synth.gpu.torch_noise import TorchNoise
from depthmocap.synth.gpu.torch_render import TorchCameras, TorchLayers, render_people
from depthmocap.synth.gpu.torch_source import TorchSynth, TorchSynthSettings
from depthmocap.synth.motion.postures import PosturePrior
from depthmocap.synth.people.bodies import random_dressed
from depthmocap.synth.people.garments import DressedBody
from depthmocap.synth.render import PosedPerson, render_person

#: 10,000 windows a second.
GOAL_MS = 0.1
#: The paper's window, and the person's box in it.
WINDOW, PERSON = 250, 190
PEOPLE = 16


def rows(bench: Bench, device: str = "cuda", batch: int = 1024) -> None:
    """Windows of 250×250 pixels, bare and dressed with noise, and pictures of 512×424."""
    if device == "cuda" and not torch.cuda.is_available():
        bench.notes.append("rendering on a GPU left out: torch finds no CUDA device")
        return
    rng, prior = np.random.default_rng(3), PosturePrior.load()
    dressed = [random_dressed(rng, "open") for _ in range(PEOPLE)]
    postures = [prior.sample(rng)[0] for _ in dressed]
    people = [one.pose(posture) for one, posture in zip(dressed, postures, strict=True)]
    cameras = [camera_before(person.vertices.mean(0).astype(float), 2.5) for person in people]
    what, name = "Window 250×250 from a posture", torch.cuda.get_device_name() if device == "cuda" else device
    place = f"{name}, batch of {batch}"

    bodies = [one.body for one in dressed]
    bare = BodyBank.of(bodies, device=device)
    full = BodyBank.of(bodies, [rest_layers(one) for one in dressed], device)
    agrees, note = _agreement(people, cameras, device)
    for bank, clothes, noise in ((bare, "bare", None), (full, "dressed, noise", TorchNoise())):
        settings = TorchSynthSettings(batch=batch, window=WINDOW, person=PERSON, truncate=0.0, occlude=0.0, noise=noise)
        source = TorchSynth(BodiesInPostures.of(bank, prior, 1000, rng), cameras[:1], settings)
        reference = Reference(
            "CPU, one core, no noise", _CpuWindows(dressed, postures, cameras, clothes == "bare"), PEOPLE
        )
        bench.measure(
            f"{what}, {clothes}", lambda source=source: _wait(source.batch(0)[0]), reference,
            items=batch, goal_ms=GOAL_MS, agrees=agrees, note=f"{place}; {note}",
        )  # fmt: skip

    chosen = torch.arange(batch // 8, device=device) % PEOPLE
    crowd = PosedPeople.of(people, device)
    at = TorchCameras.of(cameras, device)
    at = TorchCameras(at.intrinsics[chosen], at.camera_from_world[chosen])
    (_, layers), model = crowd.worn.chosen(chosen), crowd.model
    skins = model.points(crowd.vertices[chosen])
    size = cameras[0].height, cameras[0].width
    bench.measure(
        "Render a dressed person, 512×424",
        lambda: _wait(render_people(skins, model.faces, model.face_regions, at, *size, layers).depth_m),
        Reference("CPU, one core", lambda: [render_person(p, c) for p, c in zip(people, cameras, strict=True)], PEOPLE),
        items=len(chosen), agrees=agrees, note=f"{name}, batch of {len(chosen)}; {note}",
    )  # fmt: skip
    if device == "cuda":
        bench.notes.append(f"GPU memory at most {torch.cuda.max_memory_allocated() / 1e9:.1f} GB")


class _CpuWindows:
    """The same work without torch: pose, draw, normalise (into this package's own window of 192)."""

    def __init__(
        self, dressed: list[DressedBody], postures: list[np.ndarray], cameras: list[DepthCamera], bare: bool
    ) -> None:
        self.jobs, self.bare = list(zip(dressed, postures, cameras, strict=True)), bare

    def __call__(self) -> None:
        for one, posture, camera in self.jobs:
            person = PosedPerson(one.body.pose(posture)) if self.bare else one.pose(posture)
            view = render_person(person, camera)
            make_window(view.depth_m, view.person, camera)


def _wait(result: Tensor) -> None:
    """Until the device has made it."""
    if result.is_cuda:
        torch.cuda.synchronize()


def _agreement(people: list[PosedPerson], cameras: list[DepthCamera], device: str) -> tuple[bool, str]:
    """Whether pictures are the CPU's but for a pixel in a thousand, and in words."""
    crowd = PosedPeople.of(people, device)
    size = cameras[0].height, cameras[0].width
    model, layers = crowd.model, TorchLayers.of(people, device)
    got = render_people(
        model.points(crowd.vertices), model.faces, model.face_regions, TorchCameras.of(cameras, device), *size, layers
    )
    depth, labels = got.depth_m.cpu().numpy(), got.labels.cpu().numpy()
    views = [render_person(person, camera) for person, camera in zip(people, cameras, strict=True)]
    expected, truth = np.stack([view.depth_m for view in views]), np.stack([view.labels for view in views])
    pixels = np.count_nonzero(expected)
    off, wrong = int((np.abs(depth - expected) > 1e-3).sum()), int((labels != truth).sum())
    return bool(max(off, wrong) <= 1e-3 * pixels), f"of {pixels} px {off} over 1 mm off, {wrong} labels differ"
