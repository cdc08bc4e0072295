"""Names of others in charts, pictures and pages: shown as they are, whatever they hold."""

from pathlib import Path

import numpy as np

from depthmocap.calibration.calibration_page import draw_clouds
from depthmocap.frames import View
from depthmocap.geometry import DepthCamera
from depthmocap.report.charts import as_png, label_of, name_axes, new_figure
from depthmocap.report.drawing import labelled_depth_strip
from depthmocap.report.page import ReportFigure, ReportSection, ReportTable, write_report

HOSTILE = "<b>$\\frac{$</b>\x1b[2J\0\udcff"


def test_a_calibration_is_drawn_with_any_names() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    clouds: dict[str, np.ndarray] = dict.fromkeys(("$\\frac{$", "$x$", "_left", "カメラ", "[x]"), points)
    assert draw_clouds(clouds, [np.eye(4)] * 5, None).startswith(b"\x89PNG")


def test_names_in_charts_are_no_formulas_and_none_is_left_out_of_the_legend() -> None:
    figure, (axes,) = new_figure(3.0, 2.0)
    for name in ("_left", "$a_b$"):
        axes.plot([0, 1], label=label_of(name))
    legend = axes.legend()
    name_axes(axes, "$\\frac{$", "y")
    as_png(figure)
    assert [text.get_text().strip() for text in legend.get_texts()] == ["_left", "$a_b$"]


def test_a_name_stays_above_its_own_picture(tmp_path: Path) -> None:
    camera = DepthCamera("x" * 128, 32, 24, 30.0, 30.0, 16.0, 12.0)
    depth_m = np.ones((24, 32), np.float32)
    one, other = (
        labelled_depth_strip([View(camera, depth_m), View(second, depth_m)], [None, None], width=160)
        for second in (camera, DepthCamera("y", 32, 24, 30.0, 30.0, 16.0, 12.0))
    )
    np.testing.assert_array_equal(one[:, :160], other[:, :160])


def test_a_page_holds_no_markup_and_no_control_character_of_others(tmp_path: Path) -> None:
    figure = ReportFigure(np.zeros((2, 2, 3), np.uint8), HOSTILE)
    section = ReportSection(
        HOSTILE, (HOSTILE, f"`{HOSTILE}`"), (ReportTable((HOSTILE,), ((HOSTILE,),), HOSTILE),), (figure,)
    )
    write_report(tmp_path / "page.html", HOSTILE, [section] * 3)
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "<b>" not in page
    assert "&lt;b&gt;$\\frac{$&lt;/b&gt;\\x1b[2J\\x00\\udcff" in page
    assert page.replace("\n", "").isprintable()
