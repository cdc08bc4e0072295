"""Training on several processes, which torch's ``torchrun`` starts: each learns from pictures of its own, and all take
the mean of their gradients (extra: train).

    torchrun --nproc-per-node 2 --no-python depthmocap train classifier --out runs/one

A process that no ``torchrun`` has started is the first of one.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import functools
import os
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, Concatenate, ParamSpec, Protocol, TypeVar, runtime_checkable

import torch
from torch import distributed as dist
from torch import nn

from depthmocap.core.locks import locks_outputs
from depthmocap.errors import InputError


@runtime_checkable
class _Dataclass(Protocol):
    __dataclass_fields__: ClassVar[dict[str, Any]]


_Settings = TypeVar("_Settings", bound=_Dataclass)
_More = ParamSpec("_More")
_Result = TypeVar("_Result")

#: How long processes wait for each other: while one of them collects samples or validates.
_PATIENCE = datetime.timedelta(days=7)


def process_count() -> int:
    """Number of processes that train together."""
    return dist.get_world_size() if dist.is_initialized() else 1


def process_rank() -> int:
    """Number of this process, the first is 0. The first alone writes files and shows progress."""
    return dist.get_rank() if dist.is_initialized() else 0


def wait_for_all() -> None:
    """Wait until every process is here."""
    if dist.is_initialized():
        dist.barrier()


def same_everywhere(number: float) -> float:
    """The first process's number: what depends on a clock must not differ, or some would stop before others."""
    if not dist.is_initialized():
        return number
    shared = torch.tensor([number], dtype=torch.float64, device=_messenger())
    dist.broadcast(shared, 0)
    return float(shared.item())


def average_gradients(network: nn.Module) -> None:
    """Replace the gradients, and the running statistics of its norms, by their means over all processes."""
    if process_count() == 1:
        return
    with torch.no_grad():
        gradients = [p.grad for p in network.parameters() if p.grad is not None]
        statistics = [buffer for buffer in network.buffers() if buffer.is_floating_point()]
        tensors = gradients + statistics
        together = torch.cat([tensor.reshape(-1).float() for tensor in tensors])
        dist.all_reduce(together)
        together /= process_count()
        for tensor, mean in zip(tensors, together.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(mean.view_as(tensor))


def trains(
    command: Callable[Concatenate[_Settings, _More], _Result],
) -> Callable[Concatenate[_Settings, _More], _Result]:
    """Decorate a command that trains: it runs in every process that ``torchrun`` has started, on a GPU each where
    ``device`` of its settings is cuda, and the first locks their folder ``out``."""
    locked = locks_outputs(folder="out")(command)

    @functools.wraps(command)
    def run(settings: _Settings, *more: Any, **others: Any) -> _Result:
        device = getattr(settings, "device", "cpu")
        with process_group(device):
            if (own := _device_of_process(device)) != device:
                settings = dataclasses.replace(settings, device=own)
            return (locked if process_rank() == 0 else command)(settings, *more, **others)

    return run


@contextlib.contextmanager
def process_group(device: str = "cpu") -> Iterator[None]:
    """Join the processes that ``torchrun`` has started, for the block; alone where it has started none.

    Raises:
        InputError: when they cannot find each other.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or dist.is_initialized():
        yield
        return
    try:
        dist.init_process_group("nccl" if device.startswith("cuda") else "gloo", timeout=_PATIENCE)
    except (RuntimeError, ValueError) as error:
        reason = str(error).splitlines()[0][:100]
        raise InputError(f"the processes that torchrun started cannot find each other ({reason})") from None
    try:
        if device.startswith("cuda"):
            torch.cuda.set_device(_device_of_process(device))
        yield
    finally:
        dist.destroy_process_group()


def _device_of_process(name: str) -> str:
    """The device of this process: the GPU with its number on the machine, where ``name`` is cuda."""
    if name == "cuda" and dist.is_initialized():
        return f"cuda:{os.environ.get('LOCAL_RANK', '0')}"
    return name


def _messenger() -> Any:
    """The device on which processes exchange numbers."""
    return torch.device("cuda", torch.cuda.current_device()) if dist.get_backend() == "nccl" else torch.device("cpu")
