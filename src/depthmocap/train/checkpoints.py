"""Checkpoints of training runs and files of weights (extra: train)."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import torch
from torch import nn

from depthmocap.core.output import write_file
from depthmocap.core.reading.input_files import check_file, read_bytes
from depthmocap.core.reading.json_text import number, parse_json, whole_number
from depthmocap.errors import InputError

#: Largest file of weights that is read, bytes.
_LARGEST_WEIGHTS = 1 << 30


def read_checkpoint(path: Path, device: str) -> dict[str, Any]:
    """Contents of a run's checkpoint: states of the network, average and optimiser, progress and history.

    Raises:
        InputError: when it is damaged, or something else.
    """
    fault = f"{path} is damaged or no checkpoint of a run: remove it to begin anew, or use another --out"
    check_file(path)
    try:
        state = torch.load(path, map_location=device, weights_only=True)
    except Exception:  # torch and pickle raise many types for damaged files
        raise InputError(fault) from None
    if not isinstance(state, dict) or not isinstance(state.get("history"), str):
        raise InputError(fault)
    try:
        done, spent = whole_number(state.get("done"), "done"), number(state.get("spent"), "spent")
        history = parse_json(state["history"], "its history")
    except InputError:
        raise InputError(fault) from None
    if not isinstance(history, list) or min(done, spent) < 0:
        raise InputError(fault)
    return {**state, "done": done, "spent": spent, "history": history}


def load_weights(network: nn.Module, path: Path, optional: str | None = None) -> bool:
    """Load a .safetensors file into a network; names and shapes must match.

    Args:
        optional: weights whose names begin like this may be missing in the file, where the network keeps its own, or
            in the network, where they are left out.

    Returns:
        Whether the file holds all of the network.

    Raises:
        InputError: when the file is missing, malformed or of another network.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    data = read_bytes(path, _LARGEST_WEIGHTS)
    try:
        state = load(data)
        state = {k: v.float() if v.is_floating_point() else v for k, v in state.items()}
        parameters = network.state_dict()
        lacking = [k for k in parameters if k not in state]
        if optional is not None:
            kept, more = ([k for k in weights if k.startswith(optional)] for weights in (parameters, state))
            if not more:
                state |= {k: parameters[k] for k in kept}
            elif not kept:
                state = {k: v for k, v in state.items() if k not in more}
        network.load_state_dict(state)
    except (SafetensorError, RuntimeError, ValueError) as error:
        raise InputError(f"{path} does not hold weights of this network: {str(error).splitlines()[0]}") from None
    return not lacking


def save_weights(network: nn.Module, path: Path) -> None:
    """Write a network's weights as .safetensors, kernels in half precision. Norms and biases are few and keep their
    range; kernels take half the space.

    Raises:
        InputError: when the file cannot be written.
    """
    from safetensors.torch import save

    state = {k: v.half() if v.is_floating_point() and v.ndim > 1 else v for k, v in network.state_dict().items()}
    write_file(path, save({k: v.cpu().contiguous() for k, v in state.items()}))


def blend_weights(network: nn.Module, start: Path, share: float) -> None:
    """Move a network's weights by a share of the way to those that it started from.

    Raises:
        InputError: as ``load_weights``.
    """
    before = copy.deepcopy(network)
    load_weights(before, start)
    with torch.no_grad():
        for now, then in zip(network.state_dict().values(), before.state_dict().values(), strict=True):
            if now.is_floating_point():
                now.lerp_(then, share)
