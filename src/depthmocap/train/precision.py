"""Whether training multiplies in half precision (extra: train)."""

from __future__ import annotations

import torch


def in_bfloat16(choice: bool | None, device: str = "cpu") -> bool:
    """The user's choice; None chooses bfloat16 where the device has instructions for it. On a processor without them,
    training takes several times as long in bfloat16 as in float32."""
    if choice is not None:
        return choice
    if device.startswith("cuda"):
        return torch.cuda.is_bf16_supported(including_emulation=False)
    # Earlier versions of torch have no such function.
    capabilities = torch.cpu.get_capabilities() if hasattr(torch.cpu, "get_capabilities") else {}
    return device.startswith("cpu") and any(capabilities.get(name) for name in ("avx512_bf16", "amx_bf16", "bf16"))
