"""Speed against named alternatives, in one run and on one thread: ``python -m benchmarks``."""

import os

for _library in ("OMP", "OPENBLAS", "MKL", "NUMBA", "NUMEXPR"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
