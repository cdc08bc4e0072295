"""Training windows made on a GPU (extra: train), so that the network there need not wait for a CPU.

dressed = [random_dressed(rng, "open") for _ in range(1000)]
bank = BodyBank.of([one.body for one in dressed], [rest_layers(one) for one in dressed], device="cuda")
source = TorchSynth(BodiesInPostures.of(bank, postures, 100_000, rng), cameras)
for inputs, labels in source.batches(): ...
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8
from torch import Tensor

from depthmocap.body.regions import UNLABELLED
from depthmocap.classify.preprocess import PERSON, WINDOW
from depthmocap.errors import InputError
from depthmocap.geometry.cameras import DepthCamera
from depthmocap.synth.gpu.torch_bank import PeopleSource
from depthmocap.synth.gpu.torch_noise import TorchNoise, add_noise
from depthmocap.synth.gpu.torch_render import TorchCameras
from depthmocap.synth.gpu.torch_windows import view_windows


@dataclasses.dataclass(frozen=True)
class TorchSynthSettings:
    """What the windows show.

    Attributes:
        batch: windows in a batch.
        window, person: side of the window and of the person's box in it (pixels).
        distance_m, height_m: of the cameras from the person and above the lowest point of it.
        aim_m: deviation of the point that cameras look at from the person's middle.
        truncate, truncated_aim_m: share of the pictures whose camera looks further past it, so that borders cut it.
        roll_rad: deviation of the cameras' roll.
        occlude: share of the pictures of which a bar or box hides a part.
        noise: of the sensors, None for none.
    """

    batch: int = 256
    window: int = WINDOW
    person: int = PERSON
    distance_m: tuple[float, float] = (1.2, 4.5)
    height_m: tuple[float, float] = (0.2, 2.8)
    aim_m: float = 0.1
    truncate: float = 0.12
    truncated_aim_m: float = 0.7
    roll_rad: float = 0.06
    occlude: float = 0.12
    noise: TorchNoise | None = dataclasses.field(default_factory=TorchNoise)

    def __post_init__(self) -> None:
        if self.batch < 1:
            raise InputError(f"batch must be at least 1, got {self.batch}")
        if not 1 <= self.person <= self.window:
            raise InputError(f"person must be 1 to window ({self.window}) pixels, got {self.person}")
        for name in ("distance_m", "height_m"):
            low, high = getattr(self, name)
            if not low <= high:
                raise InputError(f"{name}: the minimum {low} is above the maximum {high}")


class TorchSynth:
    """Batches of training windows, each of the seed and its number alone (on one kind of device).

    Windows are drawn at the sensor's pixels, or at their own where these are coarser, and get noise, occlusion and
    normalisation as pictures of real sensors do. A window may turn out empty (the person out of view, or hidden); its
    labels are then all 255, so that it counts for nothing.

    Args:
        people: who is drawn from.
        cameras: whose sizes and intrinsics are drawn from; their places are not used.

    Raises:
        InputError: when there are no cameras.
    """

    def __init__(
        self,
        people: PeopleSource,
        cameras: Sequence[DepthCamera],
        settings: TorchSynthSettings = TorchSynthSettings(),
        seed: int = 0,
    ) -> None:
        if not cameras:
            raise InputError("TorchSynth needs at least one camera to draw intrinsics from")
        self.people, self.settings, self.seed = people, settings, seed
        self.device = people.model.faces.device
        self._intrinsics = TorchCameras.of(cameras, self.device).intrinsics
        self._sizes = torch.tensor([[camera.width, camera.height] for camera in cameras], device=self.device)

    def batches(self, first: int = 0) -> Iterator[tuple[Float[Tensor, "b 3 s s"], UInt8[Tensor, "b s s"]]]:
        """Batches without end, from a number on."""
        while True:
            yield self.batch(first)
            first += 1

    @torch.no_grad()
    def batch(self, number: int) -> tuple[Float[Tensor, "b 3 s s"], UInt8[Tensor, "b s s"]]:
        """Inputs and labels (255 where unknown: around the person, and on clothes with no skin close behind)."""
        settings, count, device = self.settings, self.settings.batch, self.device
        seed = int(np.random.SeedSequence([self.seed, number]).generate_state(1, np.uint64)[0] >> np.uint64(1))
        generator = torch.Generator(device).manual_seed(seed)
        vertices, layers = self.people.draw(count, generator)
        sensor = torch.randint(len(self._sizes), (count,), device=device, generator=generator)
        pose = random_poses(vertices, settings, generator)
        cameras = TorchCameras(self._intrinsics[sensor], pose)
        model, sizes = self.people.model, self._sizes[sensor]
        points = model.points(vertices)
        view = view_windows(
            points, model.faces, model.face_regions, cameras, sizes, layers, settings.window, settings.person
        )
        depth, mask = view.rendering.depth_m, view.rendering.person
        if settings.noise is not None:
            depth = add_noise(depth, view.step, settings.noise, generator)
            mask = depth > 0
        mask = mask & ~_hidden(count, settings, generator)
        windows, labels = view.windows(depth, mask, UNLABELLED, settings.person)
        return windows.inputs, labels


def random_poses(
    vertices: Float[Tensor, "b v 3"], settings: TorchSynthSettings, generator: torch.Generator
) -> Float[Tensor, "b 3 4"]:
    """``camera_from_world`` of cameras that look at bodies from anywhere around them (``sample.random_camera``)."""
    device, count = vertices.device, len(vertices)

    def uniform(low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(count, device=device, generator=generator, dtype=torch.float64)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, device=device, generator=generator, dtype=torch.float64)

    low, high = vertices.amin(1).double(), vertices.amax(1).double()
    centre = (low + high) / 2
    azimuth = uniform(-math.pi, math.pi)
    height = low[:, 2] + uniform(*settings.height_m) - centre[:, 2]
    distance = torch.maximum(uniform(*settings.distance_m), height.abs() * 1.1)
    ground = (distance**2 - height**2).sqrt()
    eye = centre + torch.stack([ground * azimuth.sin(), -ground * azimuth.cos(), height], 1)
    past = torch.where(uniform(0.0, 1.0) < settings.truncate, settings.truncated_aim_m, settings.aim_m)
    forward = torch.nn.functional.normalize(centre + normal(count, 3) * past[:, None] - eye, dim=1)
    up = torch.tensor([0.0, 0.0, 1.0], device=device, dtype=torch.float64).expand_as(forward)
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up), dim=1)
    down = torch.linalg.cross(forward, right)
    roll = (normal(count) * settings.roll_rad)[:, None]
    rotation = torch.stack([roll.cos() * right + roll.sin() * down, roll.cos() * down - roll.sin() * right, forward], 1)
    return torch.cat([rotation, -(rotation @ eye[:, :, None])], 2)


def _hidden(count: int, settings: TorchSynthSettings, generator: torch.Generator) -> Bool[Tensor, "b s s"]:
    """A bar or a box somewhere on some of the windows, turned any way, as furniture in front would be."""
    device, side = generator.device, settings.window
    chance, x, y, width, height, angle = torch.rand(6, count, 1, 1, device=device, generator=generator).unbind(0)
    place = torch.arange(side, device=device) / side
    u, v = place[None, None] - x, place[None, :, None] - y
    cos, sin = (angle * torch.pi).cos(), (angle * torch.pi).sin()
    along, across = (u * cos + v * sin).abs(), (v * cos - u * sin).abs()
    inside = (along < (0.05 + 0.3 * width) / 2) & (across < (0.1 + 0.6 * height) / 2)
    return inside & (chance < settings.occlude)
