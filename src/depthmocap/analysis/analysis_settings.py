"""The options of ``depthmocap analyse``."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import tyro

from depthmocap.analysis.centre_of_mass import Anthropometry
from depthmocap.core.settings import check_at_least
from depthmocap.errors import InputError


@dataclasses.dataclass(frozen=True)
class AnalyseSettings:
    """Joint angles, gait, standing up and sitting down, of takes that ``run`` or ``live`` made. No medical device.

    Each result has a folder in ``out``; parameters.csv has the numbers of all of them, and analysis.html shows them. A
    result that was analysed before, with the same settings and corrections, is not analysed again.

    Attributes:
        results: folders of results, or folders that hold such folders.
        out: another folder, for what is found.
        least_confidence: joints below it were not seen.
        fill_s: gaps of a joint up to so long (s) are filled by interpolation over time; longer ones stay gaps.
        cutoff_hz: what is faster in a joint's path is taken for noise (zero-lag Butterworth); 0 filters nothing.
        anthropometry: whose segment masses: those of women, men, or the mean of both.
        report: draw analysis.html.
    """

    results: tyro.conf.Positional[tuple[Path, ...]]
    out: Path = dataclasses.field(kw_only=True)
    least_confidence: float = dataclasses.field(default=0.5, kw_only=True)
    fill_s: float = dataclasses.field(default=0.1, kw_only=True)
    cutoff_hz: float = dataclasses.field(default=6.0, kw_only=True)
    anthropometry: Anthropometry = dataclasses.field(default="mean", kw_only=True)
    report: bool = dataclasses.field(default=True, kw_only=True)

    def check(self) -> None:
        """
        Raises:
            InputError: when a setting is out of range.
        """
        if not self.results:
            raise InputError("name one or more folders of results, or a folder that holds them")
        if not 0 <= self.least_confidence <= 1:
            raise InputError(f"--least-confidence must be from 0 to 1, got {self.least_confidence}")
        check_at_least(0, {"--fill-s": self.fill_s, "--cutoff-hz": self.cutoff_hz})
