"""Pictures, charts, animations and the report: what can be checked without looking."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from depthmocap.body.regions import DISPLAY_COLOURS, REGION
from depthmocap.body.skeleton import JOINT_INDEX, JOINTS
from depthmocap.errors import InputError
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera, z_up_from
from depthmocap.report.charts import confusion_picture, joint_error_bars, loss_curves, precision_curve
from depthmocap.report.drawing import (
    ESTIMATE_COLOUR,
    TRUTH_COLOUR,
    animation,
    cloud_picture,
    colour_labels,
    depth_picture,
    labelled_depth_strip,
)
from depthmocap.report.metrics import joint_metrics
from depthmocap.report.page import ReportFigure, ReportSection, ReportTable, write_report

STANDING = np.array([[0.05 * i - 0.4, 0, 0.1 * i] for i in range(len(JOINTS))])


def near(picture: np.ndarray, colour: tuple[int, int, int], within: int = 40) -> np.ndarray:
    return (np.abs(picture.astype(int) - colour).max(-1) <= within).nonzero()


def test_colour_labels() -> None:
    labels = np.array([[0, 1, 255], [43, 44, 2]], dtype=np.uint8)
    picture = colour_labels(labels)
    assert picture[0, 1].tolist() == DISPLAY_COLOURS[1].tolist()
    assert picture[1, 0].tolist() == DISPLAY_COLOURS[43].tolist()
    assert picture[0, 2].tolist() == picture[1, 1].tolist() == [120, 120, 120]
    depth_m = np.array([[2, 2, 0], [3, 2, 2]], dtype=np.float32)
    shaded = colour_labels(labels, depth_m)
    assert 0 < shaded[0, 0, 0] < 70 and shaded[0, 1].argmax() == 0


def test_depth_picture() -> None:
    depth_m = np.tile(np.linspace(0, 4, 50), (40, 1))
    picture = depth_picture(depth_m)
    assert picture[0, 0].tolist() == [0, 0, 0]
    assert picture[0, 2].argmax() == 0 and picture[0, -1].argmax() == 2  # red near, blue far
    masked = depth_picture(depth_m, depth_m > 2)
    assert len(set(masked[0, 10].tolist())) == 1 and len(set(masked[0, 40].tolist())) > 1
    assert not depth_picture(np.zeros((4, 5))).any()


@pytest.mark.parametrize("with_labels", [True, False])
def test_labelled_depth_strip(with_labels: bool) -> None:
    views, labels = [], []
    for name, width in (("Küche", 64), ("b", 32)):
        depth_m = np.full((48, width), 3.0, dtype=np.float32)
        person = np.zeros((48, width), dtype=np.uint8)
        person[10:30, 5:12] = REGION["chest R"]
        views.append(View(DepthCamera(name, width, 48, 60.0, 60.0, 32.0, 24.0), depth_m, person > 0))
        labels.append(person if with_labels and name == "b" else None)
    strip = labelled_depth_strip(views, labels, width=100)
    assert strip.shape == (26 + (2 if with_labels else 1) * 156, 206, 3)
    with pytest.raises(InputError, match="2 and 1"):
        labelled_depth_strip(views, labels[:1])


@pytest.mark.parametrize("up", ["z", "y", "-y"])
def test_cloud_picture_is_upright_and_shows_both_skeletons(up: str) -> None:
    rng = np.random.default_rng(0)
    cloud = np.repeat(STANDING, 1200, axis=0) + rng.normal(0, 0.03, (1200 * 18, 3))
    labels = np.where(cloud[:, 2] > 0.85, REGION["chest L"], REGION["thigh L"]).astype(np.uint8)
    estimate = STANDING + np.array([0.3, 0.3, 0])
    estimate[JOINT_INDEX["RHand"]] = np.nan
    world = z_up_from(up)
    picture = cloud_picture(cloud @ world, labels, estimate @ world, STANDING @ world, up)
    assert picture.shape == (420, 640, 3) and picture.dtype == np.uint8
    front = picture[30:, :318]
    red, cyan = near(front, (228, 45, 45), 60), near(front, (140, 230, 230), 60)
    assert red[0].mean() < cyan[0].mean()  # the chest is above the thighs
    assert near(front, ESTIMATE_COLOUR)[1].mean() > near(front, TRUTH_COLOUR)[1].mean() + 20
    same = cloud_picture(cloud, labels, estimate, STANDING)
    assert (same == picture).mean() > 0.97  # but for rounding


def test_cloud_picture_draws_the_near_over_the_far() -> None:
    grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 80), [0.0], np.linspace(0, 1, 80)), -1).reshape(-1, 3)
    cloud = np.concatenate([grid, grid + np.array([0.0, 1, 0])])
    labels = np.repeat(np.array([REGION["chest L"], REGION["thigh L"]], dtype=np.uint8), len(grid))
    picture = cloud_picture(cloud, labels)
    red, green, _ = picture[200, 160].astype(int)
    assert red > 150 > green


def test_cloud_picture_of_nothing_and_of_fixed_bounds() -> None:
    nothing = np.zeros((0, 3), dtype=np.float32)
    assert cloud_picture(nothing).shape == (420, 640, 3)
    assert cloud_picture(nothing, None, np.full((18, 3), np.nan)).shape == (420, 640, 3)
    bounds_m = np.array([[-1.0, -1, 0], [1, 1, 2]])
    # Points and joints far outside of what is shown.
    wide = cloud_picture(np.array([[0, 0, 1.0], [9e9, 0, 1], [np.nan, 0, 0]]), bounds_m=bounds_m, size=(200, 100))
    assert wide.shape == (100, 200, 3)
    assert cloud_picture(nothing, joints=STANDING + 1e7, bounds_m=bounds_m).shape == (420, 640, 3)


def opened(png: bytes) -> np.ndarray:
    with Image.open(BytesIO(png)) as image:
        assert image.format == "PNG"
        return np.array(image.convert("RGB"))


def test_charts() -> None:
    rng = np.random.default_rng(0)
    truths = rng.normal(size=(20, 18, 3))
    estimates = truths + rng.normal(0, 0.05, truths.shape)
    estimates[:, 3] = np.nan
    metrics = joint_metrics(estimates, truths)
    empty = joint_metrics(truths * np.nan, truths * np.nan)
    history = [{"step": i, "loss": 1 / (i + 1), "pixel_accuracy": i / 40} for i in range(30)]
    history[10]["valid_loss"] = 0.3
    confusion = rng.integers(0, 9, (44, 44))
    confusion[5] = 0
    pictures = [
        joint_error_bars(metrics),
        joint_error_bars(empty),
        precision_curve({"ours": metrics, "none": empty}),
        precision_curve({}),
        confusion_picture(confusion),
        loss_curves(history),
        loss_curves([]),
    ]
    for picture in pictures:
        shown = opened(picture)
        assert shown[0, 0].tolist() == [255, 255, 255] and shown.std() > 1
    assert np.abs(opened(pictures[0]).astype(int) - opened(pictures[1])).max() > 100


def test_animation(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / "walk.webp"
    frames = []
    for i in range(5):
        cloud = STANDING + np.array([0, 0, 0.05 * i])
        cloud = np.repeat(cloud, 300, axis=0) + rng.normal(0, 0.04, (300 * 18, 3))
        frames.append(cloud_picture(cloud, None, STANDING, size=(320, 180)))
    animation(frames, 10, path)
    with Image.open(path) as image:
        assert (image.format, image.size, getattr(image, "n_frames", 1)) == ("WEBP", (320, 180), 5)
        image.load()
        assert image.info["duration"] == 100 and image.info["loop"] == 0
    assert path.stat().st_size < 5 * 25_000
    with pytest.raises(InputError, match="at least one"):
        animation([], 10, path)
    with pytest.raises(InputError, match="one size"):
        animation([frames[0], frames[1][:50]], 10, path)
    with pytest.raises(InputError, match="positive"):
        animation(frames, 0, path)
    with pytest.raises(InputError, match="cannot write"):
        animation(frames, 10, path / "walk.webp")


class _Balance(HTMLParser):
    """Whether every element is closed in its place."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_report(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    table = ReportTable(["set & seed", "error"], [["<b>", 5.678], ["none", float("nan")], ["more", -12345]], "a < b")
    figures = [
        ReportFigure(np.zeros((4, 6, 3), dtype=np.uint8), '"black"'),
        ReportFigure(precision_curve({}), "curve", chart=True),
    ]
    sections = [
        ReportSection("A & B", ["`run --all` <script>alert(1)</script>"], [table], figures),
        ReportSection("Two"),
        ReportSection("Three", tables=[ReportTable(["only a header"], [])]),
    ]
    write_report(path, "Cameras > 1", sections)
    text = path.read_text(encoding="utf-8")
    parser = _Balance()
    parser.feed(text)
    assert parser.open == []
    assert "<title>Cameras &gt; 1</title>" in text and "A &amp; B" in text
    assert "<script" not in text and "&lt;script&gt;" in text and "<code>run --all</code>" in text
    assert "<td>&lt;b&gt;</td>" in text and '<td class="number">5.68</td>' in text
    assert '<td class="number">–</td>' in text and '<td class="number">−12,345</td>' in text
    assert '<th class="number">error</th>' in text and "<caption>a &lt; b</caption>" in text
    assert text.count("data:image/png;base64,") == 2 and 'alt="&quot;black&quot;" width="6" height="4"' in text
    assert 'class="chart"' in text and "prefers-color-scheme" in text and 'name="viewport"' in text
    assert not re.search(r'(src|href)="(?!data:|#)', text)  # nothing from elsewhere


def test_report_errors(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    with pytest.raises(InputError, match="1 cells where the header has 2"):
        write_report(path, "t", [ReportSection("s", tables=[ReportTable(["a", "b"], [[1]])])])
    with pytest.raises(InputError, match="PNG"):
        write_report(path, "t", [ReportSection("s", figures=[ReportFigure(b"BM")])])
    (tmp_path / "no folder").touch()
    with pytest.raises(InputError, match="cannot write"):
        write_report(tmp_path / "no folder" / "report.html", "t", [])
