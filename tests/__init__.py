"""Tests. Those that call numpy, and the commands they start, leave the other processors to their neighbours."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
