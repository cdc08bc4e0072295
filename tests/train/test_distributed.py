"""Training on several processes: real ones, started by torchrun, on the CPU."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")

from depthmocap.train.distributed import (  # noqa: E402
    average_gradients,
    process_count,
    process_group,
    process_rank,
    same_everywhere,
)

#: What each of two processes runs: a step on a batch of its own, of a network with running statistics.
_STEP = """
import sys, torch
from depthmocap.train.distributed import *
from depthmocap.train.networks import FastNet
def objective(network, seed):
    x = torch.randn(3, 3, 32, 32, generator=torch.Generator().manual_seed(seed))
    return network(x)[0].square().mean()
if __name__ == "__main__":
    torch.manual_seed(1)
    network = FastNet((8, 16, 24), (1, 1, 1))
    with process_group():
        objective(network, process_rank()).backward()
        average_gradients(network)
        told = same_everywhere(10.0 + process_rank())
        state = {"gradients": [p.grad for p in network.parameters()], "buffers": list(network.buffers()), "told": told}
        torch.save(state, f"{sys.argv[1]}/{process_rank()}.pt")
"""


def _torchrun(*command: str, folder: Path) -> None:
    launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node", "2", *command]
    done = subprocess.run(launch, cwd=folder, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_process_by_itself_is_the_first_of_one() -> None:
    network = torch.nn.Linear(2, 1)
    network(torch.ones(1, 2)).sum().backward()
    with process_group():
        assert (process_rank(), process_count(), same_everywhere(0.3)) == (0, 1, 0.3)
        average_gradients(network)
    assert network.weight.grad is not None
    assert network.weight.grad.tolist() == [[1.0, 1.0]]


@pytest.mark.slow
def test_two_processes_have_the_gradients_of_one(tmp_path: Path) -> None:
    (tmp_path / "step.py").write_text(_STEP)
    _torchrun("step.py", str(tmp_path), folder=tmp_path)
    first, second = (torch.load(tmp_path / f"{rank}.pt") for rank in (0, 1))

    space: dict[str, object] = {"__name__": "step"}
    exec(_STEP, space)
    torch.manual_seed(1)
    network = space["FastNet"]((8, 16, 24), (1, 1, 1))  # pyright: ignore[reportCallIssue]
    objective = space["objective"]
    (0.5 * (objective(network, 0) + objective(network, 1))).backward()  # pyright: ignore[reportCallIssue]
    assert first["told"] == second["told"] == 10.0
    for expected, one, other in zip(network.parameters(), first["gradients"], second["gradients"], strict=True):
        torch.testing.assert_close(one, expected.grad)
        torch.testing.assert_close(one, other, rtol=0, atol=0)
    for one, other in zip(first["buffers"], second["buffers"], strict=True):
        torch.testing.assert_close(one, other, rtol=0, atol=0)


@pytest.mark.slow
def test_torchrun_trains_a_classifier_and_votes(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    command = ("--no-python", sys.executable, "-c", "from depthmocap.cli import main; main()", "train")
    small = ("--images", "16", "--batch", "4", "--workers", "0", "--valid-images", "2", "--valid-every", "8")
    _torchrun(*command, "classifier", "--out", "run", *small, folder=tmp_path)
    rows = [json.loads(line) for line in (tmp_path / "run" / "history.jsonl").read_text().splitlines()]
    assert [row["step"] for row in rows] == [8, 16]
    assert (tmp_path / "run" / "classifier_int8.onnx").exists()

    votes = ("--samples", "12", "--views", "2", "--minutes", "0.02", "--workers", "0", "--estimators", "votes")
    _torchrun(*command, "pose", "--out", "pose", *votes, folder=tmp_path)
    assert (tmp_path / "pose" / "votes.onnx").exists()
    assert not list(tmp_path.rglob(".lock"))
