"""Every reader of files that users give: a small whole input of it, and the call that reads it."""

from __future__ import annotations

import sys
from pathlib import Path

_SUPPORT = str(Path(__file__).parents[1] / "support")
if _SUPPORT not in sys.path:
    sys.path.append(_SUPPORT)

from data_set_readers import DATA_SETS  # noqa: E402
from model_readers import MODELS  # noqa: E402
from posture_readers import POSTURES  # noqa: E402
from reader import Reader  # noqa: E402
from recording_readers import RECORDINGS  # noqa: E402
from result_readers import RESULTS  # noqa: E402

READERS: dict[str, Reader] = RESULTS | RECORDINGS | DATA_SETS | POSTURES | MODELS
