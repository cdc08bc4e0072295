"""Joint regressors fitted on people that are made on the fly, and motion capture with them. Needs the extra train.

A few samples only, to show the way: the packaged regressors were fitted on thousands.

python examples/08_training.py RECORDING OUT
"""

import sys
from pathlib import Path

import numpy as np

import depthmocap
from depthmocap.train.pose_samples import PoseSampleSettings
from depthmocap.train.train_pose import PoseTraining, train_pose


def main(recording: Path, out: Path, samples: int = 40) -> None:
    """Fit ridge regression for three cameras and capture a recording with it. Run it again, and samples are kept."""
    people = PoseSampleSettings(subset="open", samples=samples, views=(3,), vary=False, workers=0)
    train_pose(PoseTraining(out, people, estimators="ridge"))

    for estimator in (out / "ridge_network.npz", "ridge", "votes"):
        pipeline = depthmocap.load_pipeline(recording, smooth="none", estimator=str(estimator))
        errors = [
            np.linalg.norm(pipeline(frames).pose.joints - frames.true_joints, axis=1)
            for frames in depthmocap.open_source(recording)
            if frames.true_joints is not None
        ]
        print(f"{estimator}: joints are off by {100 * np.nanmean(errors):.1f} cm")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
