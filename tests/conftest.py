"""Settings for all tests, made before numpy is loaded."""

import os
import sys
from pathlib import Path

# Small matrices gain nothing from the linear algebra library's own threads, which only get in the way of each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if "PYTEST_XDIST_WORKER" in os.environ:
    # There is a process a core already; torch would start as many threads again in each.
    os.environ.setdefault("OMP_NUM_THREADS", "1")

# What tests in several folders share; tests themselves are no package.
sys.path.insert(0, str(Path(__file__).parent / "helpers"))
