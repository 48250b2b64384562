"""Compare the area that every estimator claims on one sweep, before and after 150 spoofed points."""

import numpy as np

from viewshed import ESTIMATORS, GRIDS, read_sweep
from viewshed.io.samples import junction_path

sweep = read_sweep(junction_path())
rng = np.random.default_rng(0)
spoofed = np.column_stack([rng.uniform(-60, 60, (150, 2)), rng.uniform(-1.5, 1.0, 150)]).astype(np.float32)
attacked = sweep.replace(points=np.concatenate([sweep.points, spoofed]), ring=None, intensity=None)

print(f"{'method':<22}{'benign m²':>12}{'attacked m²':>12}{'newly claimed m²':>18}")
for name, make in ESTIMATORS.items():
    estimator = make(GRIDS["road"])
    before, after = estimator.estimate(sweep), estimator.estimate(attacked)
    new_m2 = (after.visible() & ~before.visible()).sum() * estimator.grid.cell_area_m2
    print(f"{name:<22}{before.area_m2():>12.0f}{after.area_m2():>12.0f}{new_m2:>18.0f}")
