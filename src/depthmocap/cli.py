"""The command line. Every command is a frozen dataclass of settings, which is its options, and one function."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import io
import logging
import sys
import warnings
from typing import Any

import tyro
from rich.console import Console
from rich.table import Table

from depthmocap.core.console import OneLine, Terminal
from depthmocap.core.interrupts import ended_by_signals
from depthmocap.core.standard_streams import lasting_streams
from depthmocap.core.version import __version__
from depthmocap.errors import InputError, missing_extra


@dataclasses.dataclass(frozen=True)
class _Command:
    words: str
    module: str
    settings: str
    function: str
    help: str
    #: Extra that the command needs.
    extra: str = ""


_COMMANDS = (
    _Command("demo", "depthmocap.offline.demo", "DemoSettings", "demo", "motion capture of the packaged recording"),
    _Command("run", "depthmocap.offline.run", "RunSettings", "run", "motion capture of a recording or a UBC3V section"),
    _Command("live", "depthmocap.realtime.live_command", "LiveSettings", "run_live", "motion capture of live cameras"),
    _Command("record", "depthmocap.realtime.record", "RecordSettings", "record",
             "record depth cameras to an MCAP file"),
    _Command("replay", "depthmocap.realtime.replay", "ReplaySettings", "replay", "play a recording for Foxglove"),
    _Command("convert", "depthmocap.recordings.convert", "ConvertSettings", "convert",
             "a recording folder to MCAP and back, without loss"),
    _Command("info", "depthmocap.recordings.convert", "InfoSettings", "info", "what is in a recording"),
    _Command("recover", "depthmocap.recordings.convert", "RecoverSettings", "recover",
             "a whole MCAP file from one that was cut off"),
    _Command("cameras", "depthmocap.cameras.registry", "CamerasSettings", "list_cameras",
             "list the depth cameras that are connected"),
    _Command("calibrate", "depthmocap.calibration.calibrate", "CalibrateSettings", "calibrate",
             "where cameras stand, from a person who walks about"),
    _Command("label", "depthmocap.offline.label", "LabelSettings", "label_image", "body parts of one depth image"),
    _Command("synth", "depthmocap.synth.writing.generate", "SynthSettings", "generate",
             "make labelled depth data", "train"),
    _Command("sensors", "depthmocap.synth.sensing.sensor_sheet", "SensorSheetSettings", "write_sensor_sheet",
             "a picture of what each depth sensor makes of a scene", "train"),
    _Command("postures build", "depthmocap.synth.motion.pool_build", "PoolBuild", "build_pool",
             "the most dissimilar postures of motion capture clips", "train"),
    _Command("postures report", "depthmocap.synth.motion.prior_report", "PostureReport", "report_postures",
             "how close the posture prior comes to real postures", "train"),
    _Command("train classifier", "depthmocap.train.train_classifier", "ClassifierTraining", "train_classifier",
             "train a body-part classifier", "train"),
    _Command("train curriculum", "depthmocap.train.curriculum", "CurriculumTraining", "train_curriculum",
             "the paper's network by its curriculum, and without", "train"),
    _Command("train ablations", "depthmocap.train.ablations", "AblationTraining", "train_ablations",
             "what each ingredient of our classifier's training is worth", "train"),
    _Command("train pose", "depthmocap.train.train_pose", "PoseTraining", "train_pose", "fit the joint regressors"),
    _Command("train prior", "depthmocap.synth.motion.prior", "PriorTraining", "train_prior",
             "learn the posture prior from motion capture", "train"),
    _Command("evaluate ubc3v", "depthmocap.evaluate.ubc3v_protocol", "Ubc3vEvaluation", "evaluate_ubc3v",
             "accuracy on UBC3V or a set of its layout"),
    _Command("evaluate bench", "depthmocap.evaluate.bench", "BenchEvaluation", "evaluate_bench",
             "accuracy on the project's own test sets, made anew", "train"),
    _Command("evaluate recording", "depthmocap.evaluate.recording_protocol", "RecordingEvaluation",
             "evaluate_recording",
             "accuracy of run on a recording with true joints"),
    _Command("evaluate itop", "depthmocap.evaluate.itop_protocol", "ItopEvaluation", "evaluate_itop",
             "accuracy on ITOP, after a refit to its joints"),
    _Command("evaluate eval", "depthmocap.evaluate.eval3d_protocol", "EvalEvaluation", "evaluate_eval",
             "accuracy on EVAL, every person by a fit to the others"),
    _Command("evaluate mhad", "depthmocap.evaluate.mhad_protocol", "MhadEvaluation", "evaluate_mhad",
             "accuracy on Berkeley MHAD, every person by a fit to the others"),
    _Command("evaluate labels", "depthmocap.evaluate.labels", "LabelsEvaluation", "evaluate_labels",
             "confusion, swapped limbs and calibration of a classifier's labels"),
    _Command("evaluate estimators", "depthmocap.evaluate.estimator_comparison", "EstimatorComparison",
             "compare_estimators",
             "ridge, LASSO, a small network and votes on the same samples", "train"),
    _Command("evaluate panoptic", "depthmocap.evaluate.panoptic_protocol", "PanopticEvaluation", "evaluate_panoptic",
             "accuracy on the Kinects of CMU Panoptic"),
    _Command("reproduce", "depthmocap.evaluate.reproduce", "Reproduction", "reproduce",
             "the paper's tables and figures from its data sets"),
    _Command("evaluate motion", "depthmocap.evaluate.motion_protocol", "MotionEvaluation", "evaluate_motion",
             "joints over time: every filter on generated sequences", "train"),
    _Command("evaluate people", "depthmocap.evaluate.people_scenes", "PeopleEvaluation", "evaluate_people",
             "several people in generated scenes: masks, numbers, and what they do to each other", "train"),
    _Command("evaluate labels2d", "depthmocap.evaluate.labels2d", "Labels2dEvaluation", "evaluate_labels2d",
             "labels of real depth against joints found in colour"),
    _Command("compare", "depthmocap.evaluate.compare", "Comparison", "compare",
             "the numbers of two evaluations side by side"),
)  # fmt: skip


def _print_help(console: Console) -> None:
    console.print(f"depthmocap {__version__}: human motion capture from several depth cameras")
    console.print()
    table = Table.grid(padding=(0, 3))
    for command in _COMMANDS:
        table.add_row(f"  depthmocap {command.words}", command.help)
    console.print(table)
    console.print()
    console.print("depthmocap COMMAND --help tells a command's options.")


def _find(arguments: list[str]) -> tuple[_Command, list[str]] | None:
    for command in _COMMANDS:
        words = command.words.split()
        if arguments[: len(words)] == words:
            return command, arguments[len(words) :]
    return None


class _Held(io.StringIO):
    """What the parser says of an error, in colours where the terminal has them."""

    def isatty(self) -> bool:
        return sys.__stderr__ is not None and sys.__stderr__.isatty()


def _parse(settings: type, arguments: list[str], prog: str) -> Any:
    """The settings that the arguments tell.

    Raises:
        InputError: of the settings themselves, which the parser would put into a frame.
    """
    held = _Held()
    try:
        with contextlib.redirect_stderr(held):
            return tyro.cli(settings, args=arguments, prog=prog)
    except SystemExit as end:
        cause = end.__context__
        while cause is not None and not isinstance(cause, InputError):
            cause = cause.__context__
        if cause is not None:
            raise cause from None
        sys.stderr.write(held.getvalue())
        raise


def _tell_error(console: Console, error: InputError) -> None:
    console.print(f"error: {error}", style="red", soft_wrap=True)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit status. Bad input is one line on stderr and status 2; SIGTERM and SIGHUP end
    a command as Ctrl-C does, everything written, with status 143 and 129. Work goes on when nobody can be told of it,
    and text for the standard output that could not be written is status 1."""
    with lasting_streams() as out:
        try:
            with ended_by_signals() as ending:
                status = _main(arguments)
        except SystemExit as end:  # of the parser
            raise SystemExit(end.code or out.status()) from None
        return ending.status or status or out.status()


def _main(arguments: list[str] | None) -> int:
    arguments = sys.argv[1:] if arguments is None else arguments
    console, errors = Terminal(), Terminal(stderr=True)
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        _print_help(console)
        return 0
    if arguments[0] == "--version":
        console.print(__version__)
        return 0
    found = _find(arguments)
    if found is None and arguments[-1] in ("-h", "--help"):
        _print_help(console)
        return 0
    if found is None:
        _tell_error(errors, InputError(f"no command '{' '.join(arguments[:2])}'"))
        _print_help(errors)
        return 2
    command, rest = found
    # Third-party warnings about their own futures mean nothing to a user.
    warnings.simplefilter("ignore", DeprecationWarning)
    if logging.lastResort is not None:  # which prints our warnings where nobody has asked for others
        logging.lastResort.setFormatter(OneLine())
    try:
        try:
            module = importlib.import_module(command.module)
        except ModuleNotFoundError as error:
            if command.extra and not (error.name or "").startswith("depthmocap"):
                raise missing_extra(error.name or "torch", command.extra) from None
            raise
        settings = _parse(getattr(module, command.settings), rest, f"depthmocap {command.words}")
        getattr(module, command.function)(settings)
    except InputError as error:
        _tell_error(errors, error)
        return 2
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _tell_error(errors, InputError(f"{where}{error.strerror or error}"))
        return 2
    except UnicodeEncodeError as error:  # a path that a library takes as text, or a locale without the letter
        _tell_error(errors, InputError(f"{error.object!r} is no {error.encoding}: rename it, or set PYTHONUTF8=1"))
        return 2
    except KeyboardInterrupt:
        errors.print("stopped", style="red")
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
