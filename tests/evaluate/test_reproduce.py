"""``depthmocap reproduce``: one page from whichever sets are there, and what it says of those that are not."""

import json

import numpy as np
import pytest
from mhad_files import make_clips, write_mhad

from depthmocap.classify.classifier import packaged_weights
from depthmocap.cli import main
from depthmocap.datasets.mhad import MhadSet
from depthmocap.datasets.ubc3v import kinect2_camera
from depthmocap.datasets.ubc3v_write import SectionWriter
from depthmocap.evaluate import reproduce_real
from depthmocap.frames import View
from depthmocap.geometry.transforms import look_at

NET = packaged_weights()


def write_ubc3v(root):
    """One sample of each part: a board whose regions nobody could tell."""
    rng = np.random.default_rng(0)
    for subset, split in (("easy", "valid"), ("inter", "valid"), ("hard", "test")):
        views = []
        for k, eye in enumerate(((2.0, -2.5, 1.5), (-2.2, -1.0, 0.3), (0.5, 3.0, 2.6)), 1):
            mask = np.zeros((424, 512), bool)
            mask[120:300, 200:280] = True
            depth_m = np.where(mask, 2.5, 0).astype(np.float32)
            labels = np.where(mask, rng.integers(1, 44, mask.shape), 0).astype(np.uint8)
            views.append(View(kinect2_camera(f"Cam{k}", look_at(np.array(eye), np.zeros(3))), depth_m, mask, labels))
        with SectionWriter(root, f"{subset}-pose", split, 1) as writer:
            writer.write(views, rng.uniform(-0.5, 0.5, (18, 3)))


@pytest.fixture(scope="module")
def mhad(tmp_path_factory):
    root = tmp_path_factory.mktemp("mhad")
    write_mhad(root, make_clips(frames=5))
    return root


@pytest.mark.slow
def test_everything_that_is_there(mhad, tmp_path, monkeypatch):
    write_ubc3v(tmp_path / "ubc3v")
    monkeypatch.setattr(reproduce_real, "Eval", lambda root: MhadSet(root, subjects=(2,), every=4))
    out = tmp_path / "out"
    sets = [f"--ubc3v={tmp_path / 'ubc3v'}", f"--mhad={mhad}", f"--eval={mhad}"]
    assert main(["reproduce", *sets, f"--out={out}", f"--net2={NET}", "--pictures=2"]) == 0
    numbers = json.loads((out / "numbers.json").read_text())
    shares = numbers["UBC3V"]["table_2"]
    assert set(shares) == {"net 2, easy-pose", "net 2, inter-pose"}  # hard-pose has no validation set here
    assert all(0 <= share < 0.2 for share in shares.values())
    told = " ".join(numbers["UBC3V"]["missing"])
    assert "Net 1 was not given" in told and "Net 3 was not given" in told and "Net 2 on hard-pose" in told
    assert numbers["UBC3V"]["joints"]["true labels"]["frames"] == 1
    assert numbers["Berkeley MHAD"]["35 joints"]["frames"] == 20
    assert numbers["EVAL"] == {"sequences": 2}
    page = (out / "report.html").read_text()
    for text in ("Table II", "Table III", "Michel et al.", "5.45", "5.64", "80.60", "87.0", "truth blue, estimate red"):
        assert text in page, text
    assert 'src="http' not in page and page.count("<img") > 8


def test_a_set_that_cannot_be_read_does_not_keep_the_others_away(mhad, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reproduce_real, "Eval", lambda root: MhadSet(root, subjects=(1,), every=5))
    options = [f"--mhad={tmp_path}", f"--eval={mhad}", "--pictures=1"]
    assert main(["reproduce", *options, f"--out={tmp_path / 'out'}"]) == 0
    notes = json.loads((tmp_path / "out/numbers.json").read_text())["notes"]
    assert notes[0] == "UBC3V was not given." and notes[1].startswith("Berkeley MHAD is left out")
    assert "is left out" in (tmp_path / "out/report.html").read_text()


def test_nothing_to_reproduce(tmp_path, capsys):
    assert main(["reproduce", f"--out={tmp_path}"]) == 2
    assert "give at least one data set" in capsys.readouterr().err
    assert main(["reproduce", f"--out={tmp_path}", f"--mhad={tmp_path}"]) == 2
    printed = capsys.readouterr().err
    assert "give the folder with the Kinect, Mocap and Calibration" in printed and not list(tmp_path.iterdir())
    assert main(["reproduce", f"--out={tmp_path}", f"--mhad={tmp_path}", f"--net1={tmp_path / 'no.onnx'}"]) == 2
    assert "no.onnx not found" in capsys.readouterr().err
