"""What the tests of diagnoses share."""

from __future__ import annotations

from collections.abc import Callable

import fmuid

Look = Callable[..., fmuid.Diagnosis]
