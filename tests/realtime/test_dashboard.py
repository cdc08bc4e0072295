"""The terminal's view of a running motion capture."""

import io

from depthmocap.core.console import Terminal
from depthmocap.realtime.dashboard import draw_dashboard
from depthmocap.realtime.status import CameraStatus, RunStatistics


def test_what_sdks_say_is_one_harmless_line() -> None:
    counts = {"frames": 1, "missing": 0, "late": 0}
    said = "lost:\x1b[2J\n• forged [/x]"
    status = CameraStatus("[x]", said, 30.0, 0.0, 0, counts)
    out = io.StringIO()
    Terminal(file=out, width=200).print(draw_dashboard([status], RunStatistics(), 0, 1.0, [said]))
    printed = out.getvalue()
    assert printed.count(r"lost:\x1b[2J\n• forged [/x]") == 2
    assert "[x]" in printed
    assert "\x1b" not in printed
