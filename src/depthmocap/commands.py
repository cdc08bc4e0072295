"""The commands, in the groups in which help lists them. Each is a frozen dataclass of settings, which is its options,
and one function."""

from __future__ import annotations

import dataclasses
import importlib
from typing import Any

from depthmocap.errors import missing_extra


@dataclasses.dataclass(frozen=True)
class Command:
    """One command.

    Attributes:
        words: that the user types.
        module: that holds its settings and its function.
        help: what it does, in a line.
        extra: that it needs.
    """

    words: str
    module: str
    settings: str
    function: str
    help: str
    extra: str = ""

    def load(self) -> tuple[type, Any]:
        """Its settings and its function.

        Raises:
            InputError: when the extra that it needs is not installed.
        """
        try:
            module = importlib.import_module(self.module)
        except ModuleNotFoundError as error:
            if self.extra and not (error.name or "").startswith("depthmocap"):
                raise missing_extra(error.name or "torch", self.extra) from None
            raise
        return getattr(module, self.settings), getattr(module, self.function)


GROUPS: dict[str, tuple[Command, ...]] = {
    "Capture": (
        Command(
            "demo",
            "depthmocap.offline.demo",
            "DemoSettings",
            "demo",
            "motion capture of the packaged recording",
        ),
        Command(
            "cameras",
            "depthmocap.cameras.registry",
            "CamerasSettings",
            "list_cameras",
            "list the depth cameras that are connected",
        ),
        Command(
            "setup",
            "depthmocap.rigging.setup_command",
            "SetupSettings",
            "setup",
            "from plugged cameras to a rig and a skeleton, while a person walks about",
        ),
        Command(
            "record",
            "depthmocap.realtime.record",
            "RecordSettings",
            "record",
            "record depth cameras to an MCAP file",
        ),
        Command(
            "live",
            "depthmocap.realtime.live_command",
            "LiveSettings",
            "run_live",
            "motion capture of live cameras",
        ),
        Command(
            "run",
            "depthmocap.offline.run_command",
            "RunCommand",
            "run_all",
            "motion capture of recordings or a UBC3V section",
        ),
        Command(
            "view",
            "depthmocap.viewing.view_command",
            "ViewSettings",
            "view",
            "look through a recording or a run in the browser, and correct it",
            "view",
        ),
        Command(
            "replay",
            "depthmocap.realtime.replay",
            "ReplaySettings",
            "replay",
            "play a recording, and what was found in it, for other programs",
        ),
    ),
    "Export": (
        Command(
            "export",
            "depthmocap.exporting.export_command",
            "ExportSettings",
            "export",
            "files for other tools, of a take that was made",
        ),
        Command(
            "analyse",
            "depthmocap.analysis.analyse_command",
            "AnalyseSettings",
            "analyse",
            "joint angles, gait, standing up and sitting down, of takes that were made",
        ),
    ),
    "Recordings": (
        Command(
            "info",
            "depthmocap.offline.info_command",
            "InfoSettings",
            "info",
            "what is in a recording",
        ),
        Command(
            "label",
            "depthmocap.offline.label",
            "LabelSettings",
            "label_image",
            "body parts of one depth image",
        ),
        Command(
            "convert",
            "depthmocap.recordings.convert",
            "ConvertSettings",
            "convert",
            "a recording folder to MCAP and back, without loss",
        ),
        Command(
            "sync",
            "depthmocap.calibration.sync_command",
            "SyncSettings",
            "sync",
            "separate recordings as one take, in step by how somebody moves",
        ),
        Command(
            "recover",
            "depthmocap.recordings.convert",
            "RecoverSettings",
            "recover",
            "a whole MCAP file from one that was cut off",
        ),
    ),
    "Calibrate": (
        Command(
            "calibrate",
            "depthmocap.calibration.calibrate",
            "CalibrateSettings",
            "calibrate",
            "where cameras stand, from a person who walks about",
        ),
    ),
    "Data": (
        Command(
            "synth",
            "depthmocap.synth.writing.generate",
            "SynthSettings",
            "generate",
            "make labelled depth data",
            "train",
        ),
        Command(
            "postures build",
            "depthmocap.synth.motion.pool_build",
            "PoolBuild",
            "build_pool",
            "the most dissimilar postures of motion capture clips",
            "train",
        ),
        Command(
            "postures report",
            "depthmocap.synth.motion.prior_report",
            "PostureReport",
            "report_postures",
            "how close the posture prior comes to real postures",
            "train",
        ),
        Command(
            "sensors",
            "depthmocap.synth.sensing.sensor_sheet",
            "SensorSheetSettings",
            "write_sensor_sheet",
            "a picture of what each depth sensor makes of a scene",
            "train",
        ),
    ),
    "Train": (
        Command(
            "train classifier",
            "depthmocap.train.train_classifier",
            "ClassifierTraining",
            "train_classifier",
            "train a body-part classifier",
            "train",
        ),
        Command(
            "train people",
            "depthmocap.train.train_people",
            "PeopleTraining",
            "train_people",
            "train the network that finds people",
            "train",
        ),
        Command(
            "train rotations",
            "depthmocap.train.train_rotations",
            "RotationTraining",
            "train_rotations",
            "train the network that tells bones' rotations from joints",
            "train",
        ),
        Command(
            "train landmarks",
            "depthmocap.train.train_landmarks",
            "LandmarkTraining",
            "train_landmarks",
            "learn where surface landmarks are from the lengths of bones",
            "train",
        ),
        Command(
            "train front",
            "depthmocap.train.train_front",
            "FrontTraining",
            "train_front",
            "train the network that tells front from back",
            "train",
        ),
        Command(
            "train pose",
            "depthmocap.train.train_pose",
            "PoseTraining",
            "train_pose",
            "fit the joint regressors",
        ),
        Command(
            "train prior",
            "depthmocap.synth.motion.prior",
            "PriorTraining",
            "train_prior",
            "learn the posture prior from motion capture",
            "train",
        ),
    ),
    "Evaluate": (
        Command(
            "evaluate recording",
            "depthmocap.evaluate.recording_protocol",
            "RecordingEvaluation",
            "evaluate_recording",
            "accuracy of run on a recording with true joints",
        ),
        Command(
            "evaluate ubc3v",
            "depthmocap.evaluate.ubc3v_protocol",
            "Ubc3vEvaluation",
            "evaluate_ubc3v",
            "accuracy on UBC3V or a set of its layout",
        ),
        Command(
            "evaluate mhad",
            "depthmocap.evaluate.mhad_protocol",
            "MhadEvaluation",
            "evaluate_mhad",
            "accuracy on Berkeley MHAD, every person by a fit to the others",
        ),
        Command(
            "evaluate itop",
            "depthmocap.evaluate.itop_protocol",
            "ItopEvaluation",
            "evaluate_itop",
            "accuracy on ITOP, after a refit to its joints",
        ),
        Command(
            "evaluate eval",
            "depthmocap.evaluate.eval3d_protocol",
            "EvalEvaluation",
            "evaluate_eval",
            "accuracy on EVAL, every person by a fit to the others",
        ),
        Command(
            "evaluate panoptic",
            "depthmocap.evaluate.panoptic_protocol",
            "PanopticEvaluation",
            "evaluate_panoptic",
            "accuracy on the Kinects of CMU Panoptic",
        ),
        Command(
            "evaluate bench",
            "depthmocap.evaluate.bench",
            "BenchEvaluation",
            "evaluate_bench",
            "accuracy on the project's own test sets, made anew",
            "train",
        ),
        Command(
            "evaluate labels",
            "depthmocap.evaluate.labels",
            "LabelsEvaluation",
            "evaluate_labels",
            "confusion, swapped limbs and calibration of a classifier's labels",
        ),
        Command(
            "evaluate labels2d",
            "depthmocap.evaluate.labels2d",
            "Labels2dEvaluation",
            "evaluate_labels2d",
            "labels of real depth against joints found in colour",
        ),
    ),
    "Research": (
        Command(
            "reproduce",
            "depthmocap.evaluate.reproduce",
            "Reproduction",
            "reproduce",
            "the paper's tables and figures from its data sets",
        ),
        Command(
            "train curriculum",
            "depthmocap.train.curriculum",
            "CurriculumTraining",
            "train_curriculum",
            "the paper's network by its curriculum, and without",
            "train",
        ),
        Command(
            "train ablations",
            "depthmocap.train.ablations",
            "AblationTraining",
            "train_ablations",
            "what each ingredient of our classifier's training is worth",
            "train",
        ),
        Command(
            "evaluate estimators",
            "depthmocap.evaluate.estimator_comparison",
            "EstimatorComparison",
            "compare_estimators",
            "ridge, LASSO, a small network and votes on the same samples",
            "train",
        ),
        Command(
            "evaluate motion",
            "depthmocap.evaluate.motion_protocol",
            "MotionEvaluation",
            "evaluate_motion",
            "joints over time: every filter on generated sequences",
            "train",
        ),
        Command(
            "evaluate skeleton",
            "depthmocap.evaluate.skeleton_protocol",
            "SkeletonEvaluation",
            "evaluate_skeleton",
            "rotations, lengths and feet of the skeleton of files and avatars",
            "train",
        ),
        Command(
            "evaluate analysis",
            "depthmocap.evaluate.analysis_protocol",
            "AnalysisEvaluation",
            "evaluate_analysis",
            "the numbers of analyse against the truth, on generated people",
            "train",
        ),
        Command(
            "evaluate people",
            "depthmocap.evaluate.people_protocol",
            "PeopleEvaluation",
            "evaluate_people",
            "several people in generated scenes: masks, numbers, and what they do to each other",
            "train",
        ),
        Command(
            "compare",
            "depthmocap.evaluate.compare",
            "Comparison",
            "compare",
            "the numbers of two evaluations side by side",
        ),
    ),
}
COMMANDS: tuple[Command, ...] = tuple(command for group in GROUPS.values() for command in group)
