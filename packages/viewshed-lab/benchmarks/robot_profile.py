"""One profile in a process of its own, for ``benchmarks.robot``: NAME FILE.npz COUNT; prints JSON."""

import json
import sys

import numpy as np

from benchmarks.robot import profile_cost
from viewshed.pipeline import prepare_process
from viewshed.pipeline.profiles import profile_named
from viewshed.sweep import Sweep

if __name__ == "__main__":
    name, path, count = sys.argv[1:]
    prepare_process()
    with np.load(path) as file:
        sweep = Sweep(file["points"], file["intensity"], file.get("ring"))
    print(json.dumps(profile_cost(profile_named(name), sweep, int(count))))
