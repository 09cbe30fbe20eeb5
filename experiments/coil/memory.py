"""Memory of a monitoring in operation, over many windows of short ones that a logger adds to one file.

    python -m experiments.coil.memory WINDOWS

Run from the project's folder; it prints windows, resident memory and CPU time. Windows of 0.4 s have 40 samples; a
sensor falls silent now and then, so that windows are left out, and loses a fifth, so that alarms come and go.
"""

from __future__ import annotations

import gc
import os
import shutil
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import lfilter

from experiments.coil import study
from fmuid.reports.topics.monitoring import alarm_sentence
from fmuid.runs import FollowStatus, followed
from fmuid.runs import follow as following
from fmuid.runs import log_follower as follower
from fmuid.studies import Study

STEP, SAMPLES, LOOK = 0.01, 40, 500  # s; samples of a window, windows that come at once
SHOWN = 1 / 20  # of all windows, after which memory is printed
RULE = "[monitoring]\nwindow_length = 0.4\nwarmup = 0.2\nfalse_alarm_horizon = 3600.0\n"


def resident() -> float:
    """Return the resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


class Logger:
    """Adds rows of a healthy coil to a file."""

    def __init__(self, path: Path) -> None:
        self.path, self.rows = path, 0
        self._rng, self._state = np.random.default_rng(5), np.zeros(1)

    def __call__(self) -> None:
        """Add rows for some windows."""
        count, decay = SAMPLES * LOOK, np.exp(-STEP / study.TAU)
        u = np.repeat(self._rng.choice([-1.0, 1.0], count // 4), 4)
        current, self._state = lfilter([0.0, (1.0 - decay) / study.R], [1.0, -decay], u, zi=self._state)
        seen = current + np.sqrt(study.NOISE_VARIANCE) * self._rng.standard_normal(count)
        turn = self.rows // count
        if turn % 4 == 3:
            seen[10 * SAMPLES : 13 * SAMPLES] = np.nan
        if turn % 10 == 7:
            seen[200 * SAMPLES : 260 * SAMPLES] *= 0.8
        frame = pd.DataFrame({"time": STEP * (self.rows + np.arange(count)), "u": u, "i": seen}).round(6)
        frame.to_csv(self.path, mode="a", index=False, header=not self.rows)
        self.rows += count


def main(windows: int) -> None:
    """Monitor so many windows."""
    following.EVERY = follower.SETTLED = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "records").mkdir()
        shutil.copytree(study.HERE / "healthy", folder / "healthy")
        shutil.copy(study.HERE / "test1.csv", folder)
        words = (study.HERE / "test.toml").read_text(encoding="utf-8").replace("../../fmus", study.FMUS.as_posix())
        (folder / "study.toml").write_text(words + RULE, encoding="utf-8")
        log, shown = Logger(folder / "records" / "log.csv"), [0.0]
        log()

        def ended(watching: FollowStatus) -> bool:
            found = watching.monitor
            if watching.idle and found.windows >= shown[0]:
                gc.collect()
                print(f"{found.windows} windows: {resident():.0f} MB, {time.process_time():.0f} s of CPU", flush=True)
                shown[0] += SHOWN * windows
            if watching.idle and log.rows < windows * SAMPLES:
                log()
                return False
            return watching.idle

        with closing(
            followed(Study.read(folder / "study.toml"), folder / "records", folder / "out", alarm_sentence)
        ) as looks:
            any(map(ended, looks))


if __name__ == "__main__":
    main(int(sys.argv[1]))
