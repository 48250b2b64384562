"""Make the embedded sample: ``python tools/make_sample.py``. The same seed gives the same bytes."""

import sys
from dataclasses import replace

import numpy as np

from viewshed.io import write_sweep
from viewshed.io.samples import junction_path
from viewshed.sensors import lidar_model
from viewshed.sim import cast, junction

SEED = 20
HEIGHT_M = 1.84


def main() -> None:
    """Cast the junction and write it into the package."""
    model = lidar_model("hdl32e")
    between_columns = replace(model, azimuth_offset=model.azimuth_offset + model.azimuth_step / 2)
    sweep = cast(between_columns, junction(), HEIGHT_M, rng=np.random.default_rng(SEED))
    rounded = sweep.replace(points=sweep.points.round(3), intensity=np.zeros(len(sweep), np.float32))
    write_sweep(rounded, junction_path())
    sys.stdout.write(f"{junction_path().name}: {len(sweep)} points, {junction_path().stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
