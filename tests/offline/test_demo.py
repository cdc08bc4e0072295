"""The packaged recording through the packaged weights: what ``make demo`` promises."""

import pytest

from depthmocap.exporting.summary import read_summary
from depthmocap.offline.demo import DemoSettings, demo


@pytest.mark.slow
def test_demo(tmp_path):
    summary = demo(DemoSettings(tmp_path)).summary
    for name in ("pose.csv", "pose.bvh", "pose.trc", "summary.json", "report.html", "preview.webp"):
        assert (tmp_path / name).stat().st_size > 0
    assert summary["frames"] == 67
    assert summary["gaps"] == 0
    assert summary["problems"] == []
    assert summary["error"] is not None
    # Wide of what the tutorial tells, something has broken.
    assert summary["error"]["mean_joint_error_cm"] < 1.5
    assert summary["error"]["within_10cm"] > 0.99
    html = (tmp_path / "report.html").read_text()
    assert "://" not in html.replace("http://www.w3.org", "")  # self-contained
    assert read_summary(tmp_path) == summary
