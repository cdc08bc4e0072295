"""Files that evaluations leave, and two of them side by side."""

import csv
import json
import re

import numpy as np
import pytest
from rich.console import Console

from depthmocap import InputError
from depthmocap.body.skeleton import JOINTS
from depthmocap.cli import main
from depthmocap.evaluate.compare import Comparison, compare
from depthmocap.evaluate.evaluation_report import Outputs, write_outputs
from depthmocap.exporting.file_settings import FileSettings
from depthmocap.exporting.summary import Take, make_summary, write_summary
from depthmocap.frames import expected_error_m
from depthmocap.report.metrics import joint_errors_cm, joint_metrics, joint_numbers, reliability

QUIET = Console(quiet=True)


def numbers(off_m, frames=4, joints=JOINTS, **more):
    truths = np.zeros((frames, len(joints), 3))
    estimates = truths + np.array([off_m, 0.0, 0.0])
    confidence = reliability(np.full(truths.shape[:2], 0.75), joint_errors_cm(estimates, truths))
    return {"frames": frames, **joint_numbers(joint_metrics(estimates, truths, joints), confidence), **more}


def write(path, results):
    write_outputs(Outputs(json=path), "title", results)
    return path


def test_differences(tmp_path, capsys):
    a = write(tmp_path / "a.json", {"seen": numbers(0.04), "new": numbers(0.04)})
    b = write(tmp_path / "b.json", {"seen": numbers(0.03), "new": numbers(0.2)})
    values = compare(Comparison(a, b), QUIET)
    assert values["seen"]["mean joint error (cm)"] == pytest.approx((4, 3))
    assert values["new"]["joints within 10 cm (%)"] == pytest.approx((100, 0))
    assert values["new"]["RHand (cm)"] == pytest.approx((4, 20))
    assert main(["compare", str(a), str(b)]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"mean joint error\s*\(cm\).*4\.00.*3\.00.*-1\.00.*0\.75", printed)


def test_a_file_of_one_set(tmp_path):
    one = {**numbers(0.04), "subset": "hard-pose", "split": "test", "data": "somewhere"}
    a = tmp_path / "a.json"
    a.write_text(json.dumps(one))
    b = tmp_path / "b.json"
    b.write_text(json.dumps(one | {"data": "elsewhere", "mean_joint_error_cm": None}))
    values = compare(Comparison(a, b), QUIET)["hard-pose/test"]
    assert values["mean joint error (cm)"][0] == pytest.approx(4) and np.isnan(values["mean joint error (cm)"][1])


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"new": numbers(0.1)}, "different sets: seen; new"),
        ({"seen": numbers(0.1, frames=5)}, "frames of seen is 4 in A, 5 in B"),
        ({"seen": numbers(0.1, joints=JOINTS[:5])}, "18 joints in A, 5 joints in B"),
        ({"seen": numbers(0.1, seed=2)}, "seed of seen is not told in A, 2 in B"),
        ({"seen": numbers(0.1, true_joints="b")}, "the true joints of seen differ"),
        ({"seen": numbers(0.1, recipe={"sensors": ["kinect1"], "postures": "x"})}, "sensors of seen"),
    ],
)
def test_sets_that_differ_are_refused(tmp_path, other, message):
    ours = {"seen": numbers(0.04, true_joints="a")}
    a, b = write(tmp_path / "a.json", ours), write(tmp_path / "b.json", other)
    with pytest.raises(InputError, match=message):
        compare(Comparison(a, b), QUIET)


def test_how_it_was_measured_may_differ_and_is_told(tmp_path, capsys):
    a = write(tmp_path / "a.json", {"seen": numbers(0.04, views=3, data="x", about={"weights": None})})
    b = write(tmp_path / "b.json", {"seen": numbers(0.05, views=1, data="x", about={"weights": "net.onnx"})})
    assert main(["compare", str(a), str(b)]) == 0
    printed = capsys.readouterr().out
    assert "views of seen: 3 in A, 1 in B" in printed
    assert "weights of seen: the packaged ones in A, net.onnx in B" in printed
    assert "data of seen" not in printed and "labels of seen" not in printed


def test_summaries_of_takes(tmp_path):
    """Of a recording whose true joints are known."""
    errors = {key: value for key, value in numbers(0.04).items() if key != "frames"}
    for name, more in (("a", {}), ("b", {"mean_joint_error_cm": 3.0})):
        known = {"frames": 4, "error": errors | more, "ms_per_frame": {"p50": 8.0, "p95": 9.0}}
        write_summary(tmp_path / name, make_summary(Take("run", ["walks/one"], "z", FileSettings()), known))
    a, b = (tmp_path / name / "summary.json" for name in "ab")
    values = compare(Comparison(a, b), QUIET)["one"]
    assert values["mean joint error (cm)"] == pytest.approx((4, 3))
    assert values["median time of a frame (ms)"] == (8, 8)
    write_summary(tmp_path / "b", make_summary(Take("run", ["walks/one"], "z", FileSettings()), {"frames": 4}))
    with pytest.raises(InputError, match=r"the true joints of walks.one are not known"):
        compare(Comparison(a, b), QUIET)
    b.write_text(json.dumps(json.loads(a.read_text()) | {"schema": 99}))
    with pytest.raises(InputError, match="has the schema 99"):
        compare(Comparison(a, b), QUIET)


def test_what_is_not_an_evaluation(tmp_path):
    a = write(tmp_path / "a.json", {"seen": numbers(0.04)})
    b = tmp_path / "b.json"
    with pytest.raises(InputError, match="not found"):
        compare(Comparison(a, b), QUIET)
    for text, message in (("{", "is not valid JSON"), ("[1]", "holds no numbers"), ('{"a": {}}', "holds no numbers")):
        b.write_text(text)
        with pytest.raises(InputError, match=message):
            compare(Comparison(a, b), QUIET)
    for digest in ({}, [], 0, False):  # of the true joints, which is a text
        write(b, {"seen": numbers(0.04, true_joints=digest)})
        with pytest.raises(InputError, match="holds no numbers"):
            compare(Comparison(a, b), QUIET)


def test_files_of_an_evaluation(tmp_path):
    made, table, report = tmp_path / "new" / "n.json", tmp_path / "n.csv", tmp_path / "n.html"
    outputs = Outputs(json=made, csv=table, report=report)
    nothing = joint_numbers(joint_metrics(np.full((1, 18, 3), np.nan), np.full((1, 18, 3), np.nan)))
    write_outputs(
        outputs, "Two sets", {"seen": numbers(0.04, problems=["a <file> is bad"]), "none": {"frames": 1, **nothing}}
    )
    document = json.loads(made.read_text())
    assert document["none"]["mean_joint_error_cm"] is None
    assert document["seen"]["reliability"] == {
        "confidence": [0.75], "within_10cm": [1.0], "beyond_20cm": [0.0], "joints": [72],
        "error_cm": [4.0], "expected_error_cm": [pytest.approx(100 * expected_error_m(np.array([0.75]))[0])],
        "calibration_error": 0.25,
    }  # fmt: skip
    rows = list(csv.reader(table.read_text().splitlines()))
    assert rows[1] == ["seen", "Head", "4.0000", "0.0000", "1.0000"]
    assert rows[19] == ["none", "Head", "", "", ""] and len(rows) == 37
    page = report.read_text()
    assert "a &lt;file&gt; is bad" in page and "Two sets" in page
    assert page.count("<img") == 4  # curves; bars and reliability; bars
    (tmp_path / "n.html").unlink()
    (tmp_path / "n.html").mkdir()
    with pytest.raises(InputError, match=r"cannot write .*n\.html"):
        write_outputs(outputs, "Two sets", {"seen": numbers(0.04)})


def test_settings_are_told_once_where_results_share_them(tmp_path):
    shared = {"sets": ["seen", "new"], "weights": None}
    for abouts, header in (
        ((shared, shared), "<th>setting</th><th>value</th>"),
        ((shared, {"sets": None, "weights": "net.onnx"}), "<th>setting</th><th>a</th><th>b</th>"),
    ):
        page = tmp_path / "n.html"
        results = {name: numbers(0.04, about=about) for name, about in zip("ab", abouts, strict=True)}
        write_outputs(Outputs(report=page), "title", results)
        text = page.read_text()
        assert header in text and "<td>seen, new</td>" in text
        assert ("weights" in text) == ("net.onnx" in text) == (abouts[1] is not shared)
