"""On which device networks run, with other packages of ONNX Runtime played by a stand-in: only the CPU's is here."""

from __future__ import annotations

import importlib.metadata
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import onnxruntime
import pytest
from fakes import Board

from depthmocap.core import network_devices
from depthmocap.core.network_devices import ACCELERATORS, Device, networks_on
from depthmocap.core.onnx_session import open_network
from depthmocap.errors import InputError
from depthmocap.offline.pipeline_settings import load_pipeline
from depthmocap.pose.votes import VotesEstimator
from depthmocap.realtime.live_capture import BackgroundSource

VOTES = Path(network_devices.__file__).parents[1] / "pose" / "weights" / "votes.onnx"
OPEN = onnxruntime.InferenceSession


class Runtime:
    """ONNX Runtime with accelerators, which are the CPU in disguise.

    Attributes:
        seconds: that a run takes on each device.
        broken: devices that cannot open a network, or say so only afterwards ("missing").
    """

    def __init__(self, patch: pytest.MonkeyPatch, *devices: str) -> None:
        self.seconds = dict.fromkeys(("cpu", *devices), 0.0)
        self.broken: dict[str, str] = {}
        self.opened: list[str] = []
        self.inside = self.most_inside = 0
        names = [ACCELERATORS[device].provider for device in devices]
        patch.setattr(onnxruntime, "get_available_providers", lambda: [*names, "CPUExecutionProvider"])
        patch.setattr(onnxruntime, "InferenceSession", self.open)
        patch.setattr(network_devices, "_found", {})

    def open(
        self, network: bytes, options: Any, providers: Sequence[Any], **kwargs: Any
    ) -> onnxruntime.InferenceSession:
        session = OPEN(network, options, providers=["CPUExecutionProvider"])
        first = providers[0] if isinstance(providers[0], str) else providers[0][0]
        device = next((name for name, each in ACCELERATORS.items() if each.provider == first), "cpu")
        self.opened.append(device)
        if (fault := self.broken.get(device)) not in (None, "missing"):
            raise RuntimeError(f"{fault}\nand much more")
        if device != "cpu":
            assert kwargs == {"enable_fallback": 0}
            if fault != "missing":
                session.get_providers = lambda: [first, "CPUExecutionProvider"]
        run = session.run

        def slow(*arguments: Any) -> Any:
            self.inside += 1
            self.most_inside = max(self.most_inside, self.inside)
            time.sleep(self.seconds[device])
            self.inside -= 1
            return run(*arguments)

        session.run = slow  # pyright: ignore[reportAttributeAccessIssue]
        return session


def test_a_faster_accelerator_is_taken_and_a_slower_one_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    runtime = Runtime(monkeypatch, "cuda", "openvino", "coreml")
    runtime.seconds |= {"cpu": 0.01, "openvino": 0.02}
    with networks_on("auto") as devices:
        VotesEstimator()
    assert devices.running == {"votes": "cuda"}
    ran, slower = devices.lines()
    assert ran == "networks run: votes on cuda" and slower.startswith("openvino is not used for votes: 4 inputs take")
    # CoreML is in every package for macOS, and has to be asked for. What was measured is kept.
    assert set(runtime.opened) == {"cpu", "cuda", "openvino"}
    runtime.opened.clear()
    with networks_on("auto") as again:
        VotesEstimator()
    assert again.running == devices.running and runtime.opened == ["cpu", "cuda"]


@pytest.mark.parametrize(("fault", "told"), [("no driver", "no driver"), ("missing", "its libraries or its driver")])
def test_an_accelerator_that_does_not_work_is_left_alone_unless_it_was_asked_for(
    fault: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    runtime = Runtime(monkeypatch, "cuda")
    runtime.broken["cuda"] = fault
    with networks_on("auto") as devices:
        VotesEstimator()
    assert devices.running == {"votes": "cpu"}
    assert told in devices.lines()[1] and "\n" not in devices.lines()[1]
    with networks_on("cuda"), pytest.raises(InputError, match=f"--device cuda: .* cannot run votes there: {told}"):
        VotesEstimator()


@pytest.mark.parametrize("device", ["cuda", "openvino", "coreml", "directml"])
def test_a_device_that_is_there_is_taken_however_slow(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    runtime = Runtime(monkeypatch, device)
    runtime.seconds[device] = 0.005
    with networks_on(device) as devices:
        session = open_network(VOTES, "")
    assert devices.running == {"votes": device}
    # DirectML does not take two calls at a time.
    inputs = network_devices._usual_inputs(session)
    threads = [threading.Thread(target=session.run, args=(None, inputs)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if device == "directml":
        assert runtime.most_inside == 1
    # Elsewhere networks stay on the CPU.
    open_network(VOTES, "")
    assert runtime.opened[-1] == "cpu"


@pytest.mark.parametrize(
    ("device", "installed", "told"),
    [
        ("cuda", "onnxruntime", "pip uninstall -y onnxruntime, then pip install onnxruntime-gpu"),
        ("openvino", "onnxruntime-gpu", "pip uninstall -y onnxruntime-gpu, then pip install onnxruntime-openvino"),
        ("directml", "onnxruntime", "pip uninstall -y onnxruntime, then pip install onnxruntime-directml"),
        ("coreml", "onnxruntime", "is of ONNX Runtime for macOS"),
    ],
)
def test_a_device_that_is_not_there_names_the_package(
    device: Any, installed: str, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    Runtime(monkeypatch)

    def distribution(name: str) -> None:
        if name != installed:
            raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", distribution)
    with pytest.raises(InputError, match=told), networks_on(device):
        pass


def test_every_network_of_a_pipeline_runs_on_the_device(monkeypatch: pytest.MonkeyPatch) -> None:
    Runtime(monkeypatch, "openvino")
    source = BackgroundSource(Board(2).rig, {})
    pipeline = load_pipeline(source, device="openvino")
    assert pipeline.devices.running == dict.fromkeys(("fast", "leaning", "front", "votes", "people"), "openvino")
    assert pipeline.devices.lines() == ["networks run: fast, leaning, front, votes, people on openvino"]
    assert load_pipeline(source, device="cpu").devices.lines() == []
