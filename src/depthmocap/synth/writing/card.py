"""The data card of a generated set: numbers and pictures from at most 1024 of its samples.

Samples are drawn by index, so the card needs no notes from the run that made the set: it describes every 2ᵏ-th sample,
those it passes while the set is made and, after an interruption, the others drawn once more. It is therefore the same
however often a run was interrupted, and costs at most 1024 samples' time whatever the size of the set.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8
from numpy import ndarray
from scipy.spatial import KDTree

from depthmocap.body.regions import REGION_COUNT, REGION_NAMES
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.core.output import write_file
from depthmocap.synth.sample import Sample

_MOST_SAMPLES = 1024
_SHEET_SAMPLES = 8
_SHEET_WIDTH = 150
_DEPTH_EDGES_M = np.linspace(0, 8, 81)
#: Our own simple rules, by the angle of the trunk and the places of hips, wrists and ankles.
POSTURE_KINDS = ("lying", "bent", "crouching or sitting", "arm raised", "legs apart", "upright")


def card_stride(samples: int) -> int:
    """Every how many samples one is described: a power of two, so that a set that has grown keeps half of them."""
    stride = 1
    while -(-samples // stride) > _MOST_SAMPLES:
        stride *= 2
    return stride


@dataclasses.dataclass(frozen=True, eq=False)
class CardRow:
    """What the card needs of a sample; ``views`` has the columns of ``VIEW_COLUMNS``. The picture is for the sheet."""

    index: int
    group: int
    joints: Float[ndarray, "18 3"]
    regions: Int[ndarray, "44"]
    depths: Int[ndarray, "80"]
    views: Float[ndarray, "n 8"]
    picture: UInt8[ndarray, "_h _w 3"] | None


VIEW_COLUMNS = ("distance_m", "azimuth_deg", "elevation_deg", "person_px", "tall_px", "cut_off", "holes", "unlabelled")


def describe(index: int, sample: Sample, samples: int) -> CardRow | None:
    """The card's row of a sample of a set of ``count``, None where the card leaves it out."""
    stride = card_stride(samples)
    if index % stride:
        return None
    regions = np.zeros(256, np.int64)
    depths = np.zeros(len(_DEPTH_EDGES_M) - 1, np.int64)
    facing = _facing(sample.joints)
    rows = []
    for view in sample.views:
        labels = view.labels if view.labels is not None else np.zeros(view.depth_m.shape, np.uint8)
        mask = view.mask if view.mask is not None else labels > 0
        person = mask | (labels > 0)
        regions += np.bincount(labels.ravel(), minlength=256)
        depth = view.depth_m[person]
        known = depth[depth > 0]
        depths += np.histogram(known, _DEPTH_EDGES_M)[0]
        towards = view.camera.world_from_camera[:3, 3] - sample.joints[JOINT_INDEX["Hip"]]
        azimuth = np.arctan2(facing[0] * towards[1] - facing[1] * towards[0], facing @ towards[:2])
        tall = np.flatnonzero(person.any(1))
        border = person[0].any() or person[-1].any() or person[:, 0].any() or person[:, -1].any()
        pixels = max(len(depth), 1)
        rows.append([
            np.linalg.norm(towards), np.degrees(azimuth),
            np.degrees(np.arctan2(towards[2], np.linalg.norm(towards[:2]))),
            len(depth), tall[-1] - tall[0] + 1 if len(tall) else 0, border,
            1 - len(known) / pixels, np.count_nonzero(mask & (labels == 0)) / pixels,
        ])  # fmt: skip
    sheet = index // stride % max(-(-samples // stride) // _SHEET_SAMPLES, 1) == 0
    return CardRow(
        index, sample.group, sample.joints.astype(np.float32), regions[: REGION_COUNT + 1], depths,
        np.array(rows, np.float64), _thumbnails(sample) if sheet else None,
    )  # fmt: skip


def _facing(joints: Float[ndarray, "18 3"]) -> Float[ndarray, "2"]:
    """The horizontal direction that the hips face."""
    left = joints[JOINT_INDEX["LHip"]] - joints[JOINT_INDEX["RHip"]]
    facing = np.array([left[1], -left[0]])  # left × up
    return facing / max(float(np.linalg.norm(facing)), 1e-9)


def _thumbnails(sample: Sample) -> UInt8[ndarray, "_h _w 3"]:
    """Depth and below it labels of a sample's first view, small, cut to the person."""
    from depthmocap.report.drawing import labelled_depth_strip

    view = sample.views[0]
    return labelled_depth_strip([view], [view.labels], _SHEET_WIDTH)[26:-6]  # without the camera's name


def posture_kinds(joints: Float[ndarray, "n 18 3"]) -> Int[ndarray, "n"]:
    """Index into ``POSTURE_KINDS`` of each skeleton (metres, Z up)."""

    def at(name: str) -> Float[ndarray, "n 3"]:
        return joints[:, JOINT_INDEX[name]]

    trunk = at("Neck") - at("Hip")
    lean = np.degrees(np.arccos(np.clip(trunk[:, 2] / np.maximum(np.linalg.norm(trunk, axis=1), 1e-9), -1, 1)))
    leg = sum(
        np.linalg.norm(at(f"{side}{lower}") - at(f"{side}{upper}"), axis=1)
        for side in "RL"
        for upper, lower in (("Hip", "Knee"), ("Knee", "Foot"))
    ) / np.float64(2)
    hips = at("Hip")[:, 2] - np.minimum(at("RFoot")[:, 2], at("LFoot")[:, 2])
    raised = np.maximum(at("RHand")[:, 2], at("LHand")[:, 2]) > at("Head")[:, 2]
    apart = np.linalg.norm((at("RFoot") - at("LFoot"))[:, :2], axis=1) > 0.6 * leg
    return np.select([lean > 60, lean > 30, hips < 0.75 * leg, raised, apart], [0, 1, 2, 3, 4], 5)


def _normalised(joints: Float[ndarray, "n 18 3"]) -> Float[ndarray, "n 18 3"]:
    """Skeletons about the pelvis, without their heading."""
    centred = joints - joints[:, JOINT_INDEX["Hip"], None]
    facing = np.stack([_facing(skeleton) for skeleton in joints])
    turned = np.stack([centred[..., 0] * -facing[:, 1, None] + centred[..., 1] * facing[:, 0, None],
                       centred[..., 0] * facing[:, 0, None] + centred[..., 1] * facing[:, 1, None],
                       centred[..., 2]], -1)  # fmt: skip
    return turned


def _percentiles(values: ndarray) -> dict[str, float]:
    return {f"p{p}": round(float(np.percentile(values, p)), 4) for p in (5, 25, 50, 75, 95)}


def summary(rows: Sequence[CardRow]) -> dict[str, Any]:
    """The card's numbers."""
    joints = np.stack([row.joints for row in rows]).astype(np.float64)
    views = np.concatenate([row.views for row in rows])
    regions = np.sum([row.regions for row in rows], 0)[1:]
    depths = np.sum([row.depths for row in rows], 0)
    kinds = np.bincount(posture_kinds(joints), minlength=len(POSTURE_KINDS)) / len(rows)
    turned = _normalised(joints)
    columns = dict(zip(VIEW_COLUMNS, views.T, strict=True))
    nearest = np.zeros(1)
    if len(rows) > 1:
        distances, _ = KDTree(turned.reshape(len(rows), -1)).query(turned.reshape(len(rows), -1), 2)
        nearest = distances[:, 1] / np.sqrt(len(JOINTS))
    shares = np.cumsum(depths) / max(int(depths.sum()), 1)
    return {
        "described_samples": len(rows),
        "described_views": len(views),
        "groups": len({row.group for row in rows}),
        "region_pixel_share": {
            name: round(float(share), 5)
            for name, share in zip(REGION_NAMES[1:], regions / max(int(regions.sum()), 1), strict=True)
        },
        "posture_kinds": {name: round(float(share), 4) for name, share in zip(POSTURE_KINDS, kinds, strict=True)},
        "joint_deviation_m": {
            name: round(float(d), 4) for name, d in zip(JOINTS, np.linalg.norm(turned.std(0), axis=1), strict=True)
        },
        "nearest_posture_rms_m": _percentiles(nearest),
        "stature_to_skull_m": _percentiles(_heights(joints)),
        "distance_m": _percentiles(columns["distance_m"]),
        "elevation_deg": _percentiles(columns["elevation_deg"]),
        "azimuth_share": {
            name: round(float(((columns["azimuth_deg"] + 45) // 90 % 4 == i).mean()), 4)
            for i, name in enumerate(("front", "left", "back", "right"))
        },
        "person_px": _percentiles(columns["person_px"]),
        "person_rows_px": _percentiles(columns["tall_px"]),
        "views_without_person": round(float((columns["person_px"] == 0).mean()), 4),
        "views_cut_off": round(float(columns["cut_off"].mean()), 4),
        "person_pixels_without_depth": round(float(columns["holes"].mean()), 5),
        "person_pixels_unlabelled": round(float(columns["unlabelled"].mean()), 5),
        "depth_m": {
            f"p{p}": round(float(_DEPTH_EDGES_M[min(np.searchsorted(shares, p / 100), 79)]), 2) for p in (5, 50, 95)
        },
    }


def _heights(joints: Float[ndarray, "n 18 3"]) -> Float[ndarray, "n"]:
    """From the base of the skull to the ankle along the bones: a measure of size whatever the posture."""
    chain = joints[:, [JOINT_INDEX[n] for n in ("Head", "Neck", "Spine2", "Spine1", "Spine", "Hip")]]
    leg = joints[:, [JOINT_INDEX[n] for n in ("RHip", "RKnee", "RFoot")]]
    return sum((np.linalg.norm(np.diff(c, axis=1), axis=2).sum(1) for c in (chain, leg)), np.zeros(len(joints)))


def write_card(folder: Path, title: str, facts: dict[str, Any], rows: Sequence[CardRow]) -> None:
    """Write ``card.json`` (the facts and the numbers) and ``card.html`` (these, charts and the contact sheet).

    Args:
        facts: settings, version and counts of the whole set, which are shown first.
        rows: of the described samples, in order of their indices; at least one.

    Raises:
        InputError: when a file cannot be written.
    """
    from depthmocap.report.page import ReportFigure, ReportSection, ReportTable, write_report

    numbers = summary(rows)
    charts = [ReportFigure(chart, caption, chart=True) for chart, caption in _charts(rows)]
    scalars: list[tuple[str, Any]] = [(k, v) for k, v in numbers.items() if not isinstance(v, dict)]
    spreads = [(k, *v.values()) for k, v in numbers.items() if isinstance(v, dict) and "p25" in v]
    by_share = sorted(numbers["region_pixel_share"].items(), key=lambda item: item[1])
    sheet = _sheet([row.picture for row in rows if row.picture is not None])
    write_report(
        folder / "card.html",
        title,
        [
            ReportSection("The set", tables=[ReportTable(("", ""), [(k, _text(v)) for k, v in facts.items()])]),
            ReportSection(
                "Samples", figures=[ReportFigure(sheet, "Depth and labels of the first view of evenly spaced samples.")]
            ),
            ReportSection(
                "Numbers",
                [f"From {len(rows)} evenly spaced samples."],
                [
                    ReportTable(("", ""), [(k.replace("_", " "), v) for k, v in scalars], decimals=4),
                    ReportTable(
                        ("", "5 %", "25 %", "50 %", "75 %", "95 %"), [(k.replace("_", " "), *v) for k, *v in spreads]
                    ),
                    ReportTable(("postures", "%"), [(k, 100 * v) for k, v in numbers["posture_kinds"].items()]),
                    ReportTable(("seen from", "%"), [(k, 100 * v) for k, v in numbers["azimuth_share"].items()]),
                    ReportTable(
                        ("rarest regions", "% of pixels"), [(k, 100 * v) for k, v in by_share[:8]], "", 3
                    ),
                ],
                charts,
            ),
        ],
    )  # fmt: skip
    write_file(folder / "card.json", json.dumps({**facts, **numbers}, indent=1, ensure_ascii=False) + "\n")


def _text(value: Any) -> str | int | float | None:
    return value if isinstance(value, str | int | float | None) else json.dumps(value, ensure_ascii=False)


def _charts(rows: Sequence[CardRow]) -> list[tuple[bytes, str]]:
    from depthmocap.report.histograms import Histogram, histogram_row

    views = dict(zip(VIEW_COLUMNS, np.concatenate([row.views for row in rows]).T, strict=True))
    depths = np.sum([row.depths for row in rows], 0).reshape(-1, 4).sum(1)
    joints = np.stack([row.joints for row in rows]).astype(np.float64)
    regions = np.sum([row.regions for row in rows], 0)[1:]
    return [
        (
            histogram_row([
                Histogram.of("camera's distance (m)", views["distance_m"], np.linspace(0, 6, 25)),
                Histogram.of("azimuth (°; 0: front)", views["azimuth_deg"], np.linspace(-180, 180, 25)),
                Histogram.of("elevation (°)", views["elevation_deg"], np.linspace(-60, 90, 26)),
            ]),
            "Where cameras stand, from the pelvis.",
        ),
        (
            histogram_row([
                Histogram.of("skull to ankle (m)", _heights(joints), np.linspace(0.5, 2, 31)),
                Histogram.of("rows of the person (px)", views["tall_px"], np.linspace(0, 424, 27)),
                Histogram("depth of the person (m)", _DEPTH_EDGES_M[::4], depths),
            ]),
            "Sizes and depths.",
        ),
        (
            histogram_row([Histogram("region", np.arange(0.5, REGION_COUNT + 1), regions)]),
            "Pixels by region, 1–43.",
        ),
    ]  # fmt: skip


def _sheet(pictures: Sequence[UInt8[ndarray, "_h _w 3"]]) -> UInt8[ndarray, "h w 3"]:
    """Pictures in rows of eight, on dark; of different heights where cameras differ."""
    height = max(picture.shape[0] for picture in pictures)
    padded = [cv2.copyMakeBorder(p, 0, height - p.shape[0] + 6, 0, 6, cv2.BORDER_CONSTANT) for p in pictures]
    width = padded[0].shape[1]
    columns = min(len(padded), 8)
    lines = -(-len(padded) // columns)
    sheet = np.zeros((lines, columns, height + 6, width, 3), np.uint8)
    for i, picture in enumerate(padded):
        sheet[i // columns, i % columns] = picture
    return sheet.transpose(0, 2, 1, 3, 4).reshape(lines * (height + 6), columns * width, 3)
