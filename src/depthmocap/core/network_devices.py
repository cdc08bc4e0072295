"""On which device networks run: on the CPU, or on an accelerator that the installed package of ONNX Runtime knows."""

from __future__ import annotations

import contextlib
import contextvars
import dataclasses
import hashlib
import importlib.metadata
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float32
from numpy import ndarray

from depthmocap.core.cores import usable_cores
from depthmocap.errors import InputError

if TYPE_CHECKING:
    import onnxruntime

#: See :func:`networks_on`.
Device: TypeAlias = Literal["auto", "cpu", "cuda", "openvino", "coreml", "directml"]
_CPU = "CPUExecutionProvider"
#: Inputs in a measurement, as many as a rig's cameras often are.
_MEASURED = 4
#: How often they are run.
_ROUNDS = 3
#: Length that a measurement gives an axis whose length is free, such as the height of a picture,
_FREE_LENGTH = 192
#: and one that counts views.
_FREE_VIEWS = 4


class _Accelerator(NamedTuple):
    """ONNX Runtime's name for an accelerator, the package that has it, its options, whether ``auto`` tries it, and
    whether a network may run on it in several threads."""

    provider: str
    package: str
    options: dict[str, str]
    by_itself: bool = True
    threads: bool = True


ACCELERATORS: dict[str, _Accelerator] = {
    # Pictures of people have many sizes, for each of which the default would search all algorithms.
    "cuda": _Accelerator("CUDAExecutionProvider", "onnxruntime-gpu", {"cudnn_conv_algo_search": "HEURISTIC"}),
    "directml": _Accelerator("DmlExecutionProvider", "onnxruntime-directml", {}, threads=False),
    "openvino": _Accelerator(
        "OpenVINOExecutionProvider", "onnxruntime-openvino", {"device_type": "CPU", "num_of_threads": "1"}
    ),
    # Every package for macOS has it, so that nobody has chosen it by installing it.
    "coreml": _Accelerator("CoreMLExecutionProvider", "onnxruntime", {}, by_itself=False),
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class NetworkSettings:
    """What commands that run networks have in common.

    Attributes:
        device: that runs the networks: auto takes an accelerator whose ONNX Runtime is installed where it is faster
            than the CPU.
    """

    device: Device = "auto"


@dataclasses.dataclass(eq=False)
class NetworkDevices:
    """Where the networks run that were opened within :func:`networks_on`.

    Attributes:
        device: that was asked for.
        running: device by network, in the order of opening; the names are those of the files.
        notes: why an accelerator is not used, one line each.
    """

    device: Device = "cpu"
    running: dict[str, str] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)

    def lines(self) -> list[str]:
        """Lines for the user; none if there was nothing to choose."""
        if self.device in ("auto", "cpu") and not self.notes and set(self.running.values()) <= {"cpu"}:
            return []
        devices = dict.fromkeys(self.running.values())
        of_each = [", ".join(n for n, device in self.running.items() if device == running) for running in devices]
        ran = "; ".join(f"{names} on {running}" for names, running in zip(of_each, devices, strict=True))
        return [f"networks run: {ran}", *dict.fromkeys(self.notes)]


#: What "auto" has found for networks: the device, and why not others. A capture opens each of them several times.
_found: dict[bytes, tuple[str, list[str]]] = {}
_chosen: contextvars.ContextVar[NetworkDevices | None] = contextvars.ContextVar("networks_on", default=None)


@contextlib.contextmanager
def networks_on(device: Device) -> Iterator[NetworkDevices]:
    """Networks that are opened by this thread meanwhile run on a device; gives where they do.

    Args:
        device: "auto" takes an accelerator whose package is installed for the networks that are faster there than on
            the CPU, which is measured as they are opened; any other has to be there.

    Raises:
        InputError: when the installed package of ONNX Runtime does not have the device.
    """
    if device not in ("auto", "cpu"):
        _check_available(device)
    devices = NetworkDevices(device)
    token = _chosen.set(devices)
    try:
        yield devices
    finally:
        _chosen.reset(token)


def open_session(name: str, network: bytes) -> onnxruntime.InferenceSession:
    """Open a network on the device of :func:`networks_on`, outside of it on the CPU.

    Raises:
        InputError: when it cannot run on the device asked for.
    """
    devices = _chosen.get() or NetworkDevices()
    session = _open(network, None)  # which tells, too, whether it is a network at all
    if devices.device == "auto":
        key = hashlib.sha256(network).digest()
        if key not in _found:
            _found[key] = _fastest(name, network, session)
        device, notes = _found[key]
        devices.notes += notes
    else:
        device = devices.device
    if device != "cpu":
        try:
            session = _open(network, device)
            session.run(None, _usual_inputs(session))
        except Exception as error:  # the runtime's errors share no public base class
            raise InputError(f"--device {device}: ONNX Runtime cannot run {name} there: {_reason(error)}") from None
    devices.running[name] = device
    return session


def _fastest(name: str, network: bytes, session: onnxruntime.InferenceSession) -> tuple[str, list[str]]:
    """The device on which a network is fastest, ``session`` is its on the CPU, and why others are not used."""
    available = _available()
    candidates = [device for device, it in ACCELERATORS.items() if it.by_itself and it.provider in available]
    device, notes = "cpu", []
    best_s = _seconds(session) if candidates else 0.0
    for candidate in candidates:
        try:
            seconds = _seconds(_open(network, candidate))
        except Exception as error:  # the runtime's errors share no public base class
            notes.append(f"{candidate} is not used: ONNX Runtime cannot run {name} there: {_reason(error)}")
            continue
        if seconds < best_s:
            device, best_s = candidate, seconds
        else:
            notes.append(
                f"{candidate} is not used for {name}: {_MEASURED} inputs take {1e3 * seconds:.1f} ms there, and "
                f"{1e3 * best_s:.1f} ms on {device}"
            )
    return device, notes


def _reason(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]


def _available() -> Sequence[str]:
    import onnxruntime

    return onnxruntime.get_available_providers()


def _check_available(device: str) -> None:
    accelerator = ACCELERATORS.get(device)
    if accelerator is None:
        raise InputError(f"--device takes auto, cpu, {', '.join(ACCELERATORS)}, not {device!r}")
    if accelerator.provider in _available():
        return
    if device == "coreml":
        raise InputError("--device coreml is of ONNX Runtime for macOS, which this is not")
    packages = ["onnxruntime", *(accelerator.package for accelerator in ACCELERATORS.values())]
    installed = [name for name in dict.fromkeys(packages) if _is_installed(name)] or ["onnxruntime"]
    raise InputError(
        f"--device {device} needs another package of ONNX Runtime: pip uninstall -y {' '.join(installed)}, then "
        f"pip install {accelerator.package}"
    )


def _is_installed(package: str) -> bool:
    try:
        importlib.metadata.distribution(package)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _open(network: bytes, device: str | None) -> onnxruntime.InferenceSession:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.log_severity_level = 3
    if device is None:
        return onnxruntime.InferenceSession(network, options, providers=[_CPU])
    accelerator = ACCELERATORS[device]
    providers: Any = [(accelerator.provider, accelerator.options), _CPU]
    if not accelerator.threads:
        options.enable_mem_pattern = False
    # Not back to the CPU, which the runtime would do with a print.
    session = onnxruntime.InferenceSession(network, options, providers=providers, enable_fallback=0)
    if accelerator.provider not in session.get_providers():
        raise InputError("its libraries or its driver are missing")
    if not accelerator.threads:
        session.run = _one_at_a_time(session.run)
    return session


def _one_at_a_time(run: Callable[..., Any]) -> Callable[..., Any]:
    """A function that waits while another thread is in it."""
    lock = threading.Lock()

    def locked(*arguments: Any) -> Any:
        with lock:
            return run(*arguments)

    return locked


def _seconds(session: onnxruntime.InferenceSession) -> float:
    """The least time for a few inputs at once, by as many threads as there are cores, as pictures are labelled."""
    inputs = _usual_inputs(session)
    session.run(None, inputs)
    times = []
    with ThreadPoolExecutor(usable_cores()) as pool:
        for _ in range(_ROUNDS):
            start = time.perf_counter()
            list(pool.map(lambda _: session.run(None, inputs), range(_MEASURED)))
            times.append(time.perf_counter() - start)
    return min(times)


def _usual_inputs(session: onnxruntime.InferenceSession) -> dict[str, Float32[ndarray, "..."]]:
    return {
        end.name: np.ones([_length(axis, i) for i, axis in enumerate(end.shape)], np.float32)
        for end in session.get_inputs()
    }


def _length(axis: int | str | None, index: int) -> int:
    """A usual length of an axis of an input: "8*steps" stands for a multiple of 8."""
    if isinstance(axis, int):
        return axis
    factor = str(axis).split("*")[0]
    return int(factor) * (_FREE_LENGTH // int(factor)) if factor.isdigit() else _FREE_VIEWS if index else 1
