"""The voting network: parts of the body vote for joints (extra: train). ``pose.votes`` runs its ONNX form."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from depthmocap.body.landmarks import POINT_JOINTS, POINTS
from depthmocap.body.regions import REGION_COUNT
from depthmocap.body.skeleton import JOINTS
from depthmocap.pose.parts import CENTRE, COUNT, MIRRORED, PART_COLUMNS, PART_COUNT

_HIDDEN = -1e9
#: Unit of the votes' offsets, metres.
_UNIT_M = 0.3


class _Block(nn.Module):
    """Self-attention, then a layer on each token; both residual."""

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
    """Compares a camera's part with the same part in the other cameras, and with its mirror image in all cameras, to
    recognise swapped sides."""

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
        summaries = []
        for i in range(2):
            other_tokens, other_centres, unseen = tokens, centres, hidden
            if i:
                other_tokens, other_centres, unseen = (
                    array.index_select(2, self.mirrored) for array in (other_tokens, other_centres, unseen)
                )
            between = (other_centres.unsqueeze(1) - centres.unsqueeze(2)) / _UNIT_M
            far = (between.square().sum(-1, keepdim=True) + 1e-6).sqrt()
            pairs = self.mine[i](tokens).unsqueeze(2) + self.theirs[i](other_tokens).unsqueeze(1)
            pairs = nn.functional.gelu(pairs + self.between[i](torch.cat([between, far], -1)))
            without = unseen.unsqueeze(1).expand(-1, tokens.shape[1], -1, -1)
            if not i:
                without = without | (views[:, None] == views).unsqueeze(-1)
            strongest = pairs.masked_fill(without.unsqueeze(-1), _HIDDEN).amax(2)
            summaries.append(torch.where(without.all(2).unsqueeze(-1), 0.0, strongest))
        return self.out(torch.cat(summaries, -1))


class _Points(nn.Module):
    """Points of the skin (``body.landmarks.POINTS``) from the tokens that joints are told from, which they do not
    change.

    Each visible part votes for each point, as for joints, by the offset of the point's joint and a little more. One
    vote more is relative to where that joint is estimated. At first a point is at its mean place beside it.
    """

    def __init__(self, width: int, inner: int = 64) -> None:
        super().__init__()
        count = len(POINTS)
        self.joint: Tensor
        self.register_buffer("joint", torch.from_numpy(POINT_JOINTS), persistent=False)
        self.offsets = nn.Linear(width, 3 * count)
        self.ask = nn.Parameter(torch.zeros(count, width))
        self.beside = nn.Sequential(nn.Linear(width, inner), nn.GELU())
        self.own = nn.Parameter(torch.zeros(count, inner, 4))
        self.own_weight = nn.Parameter(torch.full((count,), 8.0))
        self.sure = nn.Parameter(torch.zeros(count, inner))
        self.sure_bias = nn.Parameter(torch.zeros(count))
        self.usual_place = nn.Parameter(torch.zeros(count, 3))
        self.usual_weights = nn.Parameter(torch.zeros(count, PART_COUNT))
        nn.init.zeros_(self.offsets.weight)
        nn.init.zeros_(self.offsets.bias)

    def forward(
        self, regions: Tensor, joints: Tensor, votes: Tensor, attention: Tensor, keys: Tensor, estimates: Tensor
    ) -> tuple[Tensor, Tensor]:
        # regions (n, 61, width), joints (n, 18, width), votes (n, 61, 18, 3), attention (n, 18, 61), keys as regions,
        # estimates (n, 18, 3)
        offsets = self.offsets(regions).unflatten(-1, (len(POINTS), 3)) * _UNIT_M
        votes = votes.index_select(2, self.joint) + self.usual_place + offsets
        beside = self.beside(joints).index_select(1, self.joint)
        own = (beside.unsqueeze(-1) * self.own).sum(2)
        place = estimates.index_select(1, self.joint) + self.usual_place + own[..., :3] * _UNIT_M
        asked = attention.index_select(1, self.joint) + self.usual_weights
        asked = asked + self.ask @ keys.transpose(1, 2) * self.ask.shape[1] ** -0.5
        share = torch.softmax(torch.cat([asked, (own[..., 3] + self.own_weight).unsqueeze(-1)], -1), -1)
        points = (share[..., :-1, None] * votes.transpose(1, 2)).sum(2) + share[..., -1:] * place
        return points, (beside * self.sure).sum(-1) + self.sure_bias


class VotesNet(nn.Module):
    """From statistics of the regions in each camera to joints, all in the body's frame.

    Each camera's token of a part is compared with that of the other cameras, and attends to the camera's other parts.
    Then the tokens of a part are averaged over the cameras with learnt weights. The tokens of the parts and one token
    per joint attend to each other. Then each visible part votes for each joint with an offset from its centre, and each
    joint weighs the votes. Offsets and weights have a constant part, set from the samples' means (:meth:`start_from`),
    so that the network learns only the differences. Each joint also has one vote relative to the frame, for samples in
    which little is visible. The order of the cameras makes no difference.

    ``forward`` gives joints (n, 18, 3) in metres and the logit of the probability that a joint is within 10 cm (n, 18),
    and, of a network with ``points``, the same of those of the skin (n, 18, 3) and (n, 18).
    """

    def __init__(self, width: int = 128, layers: int = 3, heads: int = 4, points: bool = True) -> None:
        super().__init__()
        self.sizes = (width, layers, heads)
        self.look, self.look_at_joints = nn.Linear(PART_COLUMNS, width), nn.Linear(PART_COLUMNS, width)
        self.region = nn.Parameter(torch.randn(PART_COUNT, width) * 0.1)
        self.others = _Others(width)
        self.missed = nn.Parameter(torch.randn(PART_COUNT, width) * 0.1)
        self.within = _Block(width, heads)
        # At first, the comparisons change nothing.
        for layer in (self.others.out, self.within.out, self.within.each[-1]):
            assert isinstance(layer, nn.Linear)
            nn.init.zeros_(layer.weight)
            nn.init.zeros_(layer.bias)
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
        self.points = _Points(width) if points else None

    def start_from(self, offsets: Tensor, variances: Tensor, places: Tensor) -> None:
        """Set the constant parts: offsets (61, 18, 3) of joints from parts, their variances (61, 18), whose inverses
        are the weights, and the joints' mean positions (18, 3), all in metres."""
        with torch.no_grad():
            self.usual_offsets.copy_(offsets)
            self.usual_weights.copy_(-variances.clamp(min=1e-4).log().T)
            self.usual_place.copy_(places)
            for layer in (self.offsets, self.own):
                layer.weight.mul_(0.1)
                layer.bias.zero_()

    def forward(self, parts: Tensor) -> tuple[Tensor, ...]:
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
        keys = self.answer(regions)
        attention = self.usual_weights + self.ask(joints) @ keys.transpose(1, 2) * self.sizes[0] ** -0.5
        attention = attention.masked_fill(nobody.transpose(1, 2), _HIDDEN)
        frame_vote = self.own(joints)
        share = torch.softmax(torch.cat([attention, frame_vote[..., 3:]], -1), -1)
        place = self.usual_place + frame_vote[..., :3] * _UNIT_M
        # A sum, not a product of matrices, which half precision would round to 4 mm.
        estimates = (share[..., :-1, None] * votes.transpose(1, 2)).sum(2) + share[..., -1:] * place
        sure = self.sure(joints).squeeze(-1)
        if self.points is None:
            return estimates, sure
        return estimates, sure, *self.points(regions, joints, votes, attention, keys, estimates)
