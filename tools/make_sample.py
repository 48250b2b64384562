"""Make the embedded sample and its truth: ``python tools/make_sample.py``. The same seed gives the same bytes."""

import io
import sys
from dataclasses import replace

import numpy as np

from viewshed._files import write_atomic
from viewshed.fov.visibility import CAR
from viewshed.grid import GRIDS
from viewshed.io import write_sweep
from viewshed.io.samples import junction_path, junction_truth_path
from viewshed.sensors import LidarModel, lidar_model
from viewshed_lab.sim import cast, junction
from viewshed_lab.sim.scene import scan_of
from viewshed_lab.sim.truth.exact import exact_truth

SEED = 20
HEIGHT_M = 1.84


def sample_model() -> LidarModel:
    """Return the HDL-32E of the sample, which fires half a column later than in the table."""
    model = lidar_model("hdl32e")
    return replace(model, azimuth_offset=model.azimuth_offset + model.azimuth_step / 2)


def truth_content() -> bytes:
    """Return the NPZ of the sample's truth for a car on the grid ``road``: returns, states, mask of known cells."""
    scan = scan_of(sample_model(), junction(), HEIGHT_M)
    truth, known = exact_truth(scan, junction().world(), GRIDS["road"], (CAR,))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, expected_returns=truth.expected_returns["car"], state=truth.state["car"], known=known)
    return buffer.getvalue()


def main() -> None:
    """Simulate the junction, and write sweep and truth into the package."""
    sweep = cast(sample_model(), junction(), HEIGHT_M, rng=np.random.default_rng(SEED))
    rounded = sweep.replace(points=sweep.points.round(3), intensity=np.zeros(len(sweep), np.float32))
    write_sweep(rounded, junction_path())
    write_atomic(junction_truth_path(), truth_content())
    for path in (junction_path(), junction_truth_path()):
        sys.stdout.write(f"{path.name}: {path.stat().st_size} bytes\n")
    sys.stdout.write(f"{len(sweep)} points\n")


if __name__ == "__main__":
    main()
