"""Rows of the classifiers, against the paper's network: views in, labels out, in all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from timing import Bench, Reference

from depthmocap.classify.classifier import Classifier, packaged_weights
from depthmocap.synth.sample import Recipe, Sampler

if TYPE_CHECKING:
    from depthmocap.classify.window import NetworkName
    from depthmocap.train.networks import Network

#: Goal per view, milliseconds, where four views are labelled in one call.
GOALS_MS: dict[NetworkName, float] = {"fast": 6.0}
#: Goal of the ratio of the paper network's time to ours.
GOAL_RATIO = 4.0


def load_classifier(bench: Bench, name: NetworkName = "fast") -> Classifier:
    """The packaged classifier, or one with random weights, which takes as long; in 8 bits, as they are used."""
    if name == "fast" and packaged_weights().is_file():
        return Classifier(threads=bench.threads)
    bench.notes.append(f"no packaged {name} classifier: a network with random weights stands in for it")
    return random_classifier(bench, name, integer=True)


def random_classifier(bench: Bench, name: NetworkName, integer: bool = False) -> Classifier:
    """A network with random weights, which takes as long as a trained one."""
    import torch

    from depthmocap.train.networks import NETWORKS
    from depthmocap.train.onnx_export import export_onnx
    from depthmocap.train.quantise import quantise

    path = bench.folder / f"random_{name}.onnx"
    if not path.exists():
        torch.manual_seed(0)
        network = NETWORKS[name]()
        export_onnx(network, path, {"network": name})
        if integer:
            quantise(path, list(torch.rand(8, *network.input_shape).numpy()), path)
    return Classifier(path, bench.threads)


def size(network: Network) -> str:
    """Weights and biases of a network, and the operations (a multiply-add counted as two) of its convolutions and
    deconvolutions for a view, without our head, which only the person's pixels have."""
    import torch
    from torch import Tensor, nn

    total = 0

    def count(layer: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        nonlocal total
        if isinstance(layer, nn.Conv2d | nn.ConvTranspose2d):
            # A convolution's kernel is applied once an output pixel, a deconvolution's once an input pixel.
            pixels = (output if isinstance(layer, nn.Conv2d) else inputs[0])[:, 0].numel()
            total += 2 * layer.weight.numel() * pixels

    hooks = [module.register_forward_hook(count) for module in network.modules()]
    with torch.no_grad():
        network.eval()(torch.zeros(1, *network.input_shape))
    for hook in hooks:
        hook.remove()
    parameters = sum(parameter.numel() for parameter in network.parameters())
    return f"{parameters / 1e6:.3f} M parameters, {total / 1e9:.2f} GFLOP a view"


def labelling(bench: Bench) -> None:
    """Views in, labels out, by our networks and by the paper's, each with its own pre- and postprocessing."""
    from depthmocap.train.networks import NETWORKS

    paper = random_classifier(bench, "paper")
    sample = Sampler(Recipe("open", views=4, sensors=("kinect2",), noise="sensor"), seed=3)(0)
    views = list(sample.views)
    masks = [view.mask for view in views if view.mask is not None]
    bench.notes.append("; ".join(f"{name}: {size(kind())}" for name, kind in NETWORKS.items()))
    for name, goal_ms in GOALS_MS.items():
        ours = load_classifier(bench, name)
        for count in (1, len(views)):
            bench.measure(
                f"Label a view ({name}), {count} view{'s' * (count > 1)} a call",
                lambda n=count, ours=ours: ours.label_views(views[:n], masks[:n]),
                Reference("paper's network", lambda n=count: paper.label_views(views[:n], masks[:n]), count),
                items=count,
                goal_ms=goal_ms if count > 1 else None,
                note=f"{bench.threads} views at a time, windows and labels of the picture included; "
                f"ratio: goal {GOAL_RATIO:g}",
            )
