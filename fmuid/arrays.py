"""The types of arrays, named once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
"""An array of double precision."""

Complexes = NDArray[np.complex128]
"""An array of complex numbers of double precision."""

Indices = NDArray[np.intp]
"""An array of indices."""
