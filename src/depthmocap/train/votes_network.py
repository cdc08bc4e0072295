"""The network by which parts vote for joints (extra: train). Inference runs its ONNX form, see ``votes``."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.pose.parts import CENTRE, COUNT, MIRRORED, PART_COLUMNS, PART_COUNT

_HIDDEN = -1e9
#: Votes are told in units of so many metres.
_UNIT_M = 0.3


class _Block(nn.Module):
    """Attention among tokens, then a layer on each; both added to what comes in."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.before, self.between = nn.LayerNorm(width), nn.LayerNorm(width)
        self.mix, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.each = nn.Sequential(nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, x: Tensor) -> Tensor:
        n, tokens, width = x.shape
        q, k, v = self.mix(self.before(x)).reshape(n, tokens, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        weights = torch.softmax(q @ k.transpose(-1, -2) * (width / self.heads) ** -0.5, -1)
        x = x + self.out((weights @ v).transpose(1, 2).reshape(n, tokens, width))
        return x + self.each(self.between(x))


class _Others(nn.Module):
    """What the other cameras saw of a part, and all cameras of its mirror image, for the token of each camera's part:
    whether they agree, or whether sides were taken for each other."""

    def __init__(self, width: int, inner: int = 32) -> None:
        super().__init__()
        self.mine = nn.ModuleList(nn.Linear(width, inner) for _ in range(2))
        self.theirs = nn.ModuleList(nn.Linear(width, inner) for _ in range(2))
        self.between = nn.ModuleList(nn.Linear(4, inner) for _ in range(2))
        self.out = nn.Linear(2 * inner, width)
        self.mirrored: Tensor
        self.register_buffer("mirrored", torch.from_numpy(MIRRORED), persistent=False)

    def forward(self, tokens: Tensor, centres: Tensor, hidden: Tensor) -> Tensor:
        # tokens (n, views, 61, width), centres (n, views, 61, 3), hidden (n, views, 61)
        views = torch.arange(tokens.shape[1], device=tokens.device)
        found = []
        for i in range(2):
            others, there, unseen = tokens, centres, hidden
            if i:
                others, there, unseen = (each.index_select(2, self.mirrored) for each in (others, there, unseen))
            between = (there.unsqueeze(1) - centres.unsqueeze(2)) / _UNIT_M
            far = (between.square().sum(-1, keepdim=True) + 1e-6).sqrt()
            pairs = self.mine[i](tokens).unsqueeze(2) + self.theirs[i](others).unsqueeze(1)
            pairs = nn.functional.gelu(pairs + self.between[i](torch.cat([between, far], -1)))
            without = unseen.unsqueeze(1).expand(-1, tokens.shape[1], -1, -1)
            if not i:
                without = without | (views[:, None] == views).unsqueeze(-1)
            most = pairs.masked_fill(without.unsqueeze(-1), _HIDDEN).amax(2)
            found.append(torch.where(without.all(2).unsqueeze(-1), 0.0, most))
        return self.out(torch.cat(found, -1))


class VotesNet(nn.Module):
    """What cameras saw of regions to joints, all in the body's frame.

    What each camera saw of a part is compared with what the others saw of it, and with the other parts it saw. Then
    what several cameras saw of a part is weighed into one token. The tokens of the parts and one of each joint look
    at each other; then every seen part votes for every joint, as an offset from its centre, and each joint weighs
    the votes. Both have a part that is always the same, set from the samples' means (:meth:`start_from`), so that the
    rest has only the differences to learn. A joint has one vote of its own, relative to the frame, for when little was
    seen. The order of the cameras makes no difference.

    ``forward`` gives joints (n, 18, 3) in metres and the logit of the probability that a joint is within 10 cm (n, 18).
    """

    def __init__(self, width: int = 128, layers: int = 3, heads: int = 4) -> None:
        super().__init__()
        self.sizes = (width, layers, heads)
        self.look, self.look_at_joints = nn.Linear(PART_COLUMNS, width), nn.Linear(PART_COLUMNS, width)
        self.region = nn.Parameter(torch.randn(PART_COUNT, width) * 0.1)
        self.others = _Others(width)
        self.missed = nn.Parameter(torch.randn(PART_COUNT, width) * 0.1)
        self.within = _Block(width, heads)
        # At first, every camera is taken as it is.
        for layer in (self.others.out, self.within.out, self.within.each[-1]):
            nn.init.zeros_(layer.weight)  # pyright: ignore[reportArgumentType]
            nn.init.zeros_(layer.bias)  # pyright: ignore[reportArgumentType]
        self.view = nn.Sequential(nn.GELU(), nn.Linear(width, width))
        self.trust = nn.Sequential(nn.GELU(), nn.Linear(width, 1))
        self.unseen = nn.Parameter(torch.randn(PART_COUNT, width) * 0.1)
        self.joint = nn.Parameter(torch.randn(len(JOINTS), width) * 0.1)
        self.blocks = nn.ModuleList(_Block(width, heads) for _ in range(layers))
        self.last = nn.LayerNorm(width)
        self.offsets = nn.Linear(width, 3 * len(JOINTS))
        self.ask, self.answer = nn.Linear(width, width), nn.Linear(width, width)
        self.own = nn.Linear(width, 4)
        self.sure = nn.Linear(width, 1)
        self.usual_offsets = nn.Parameter(torch.zeros(PART_COUNT, len(JOINTS), 3))
        self.usual_weights = nn.Parameter(torch.zeros(len(JOINTS), PART_COUNT))
        self.usual_place = nn.Parameter(torch.zeros(len(JOINTS), 3))

    def start_from(self, offsets: Tensor, variances: Tensor, places: Tensor) -> None:
        """Start as the best voter that knows nothing but means: offsets (61, 18, 3) of joints from parts, their
        variances (61, 18), whose inverses are the weights, and the joints' mean places (18, 3), all in metres."""
        with torch.no_grad():
            self.usual_offsets.copy_(offsets)
            self.usual_weights.copy_(-variances.clamp(min=1e-4).log().T)
            self.usual_place.copy_(places)
            for layer in (self.offsets, self.own):
                layer.weight.mul_(0.1)
                layer.bias.zero_()

    def forward(self, parts: Tensor) -> tuple[Tensor, Tensor]:
        # parts: (n, views, 61, 16), see parts.network_inputs; unseen rows are 0.
        hidden = (parts[..., COUNT] == 0).unsqueeze(-1)
        regions, joints = parts.split([REGION_COUNT, len(JOINTS)], 2)
        looked = torch.cat([self.look(regions), self.look_at_joints(joints)], 2) + self.region
        looked = looked + self.others(looked, parts[..., CENTRE], hidden.squeeze(-1))
        looked = self.within(torch.where(hidden, self.missed, looked).flatten(0, 1)).unflatten(0, parts.shape[:2])
        weights = torch.softmax(self.trust(looked).masked_fill(hidden, _HIDDEN), 1)
        centre = (weights * parts[..., CENTRE]).sum(1)
        nobody = hidden.all(1)
        tokens = torch.where(nobody, self.unseen, (weights * self.view(looked)).sum(1) + self.region)
        x = torch.cat([tokens, self.joint.expand(parts.shape[0], -1, -1)], 1)
        for block in self.blocks:
            x = block(x)
        regions, joints = self.last(x).split([PART_COUNT, len(JOINTS)], 1)
        offsets = self.usual_offsets + self.offsets(regions).unflatten(-1, (len(JOINTS), 3)) * _UNIT_M
        votes = centre.unsqueeze(2) + offsets
        heard = self.usual_weights + self.ask(joints) @ self.answer(regions).transpose(1, 2) * self.sizes[0] ** -0.5
        heard = heard.masked_fill(nobody.transpose(1, 2), _HIDDEN)
        own = self.own(joints)
        share = torch.softmax(torch.cat([heard, own[..., 3:]], -1), -1)
        place = self.usual_place + own[..., :3] * _UNIT_M
        # No product of matrices, which half precision would round to 4 mm.
        found = (share[..., :-1, None] * votes.transpose(1, 2)).sum(2) + share[..., -1:] * place
        return found, self.sure(joints).squeeze(-1)
