"""Is someone lying? What the monitor that comes with viewshed says of an honest sweep, and of the same sweep forged.

Of one sweep it finds some lies and misses others: docs/results/monitor.md says how many. Earlier sweeps help it.
"""

import numpy as np

from viewshed import GRIDS, attacks, read_sweep
from viewshed.io.samples import junction_path
from viewshed.monitor import StreamMonitor
from viewshed.monitor.sweep_monitor import shipped_monitor
from viewshed.preprocess.leveling import level

sweep = read_sweep(junction_path())
monitor = shipped_monitor()
forged = {
    "a wedge 5 m too far": attacks.Relay(sector_deg=30.0),
    "a wall 40 m away": attacks.FarWall(sector_deg=20.0),
    "a car that is not there": attacks.GhostCar(),
}
sweeps = {"honest": sweep} | {
    name: attack.apply(sweep, np.random.default_rng(0)).sweep for name, attack in forged.items()
}
for name, seen in sweeps.items():
    stream = StreamMonitor(monitor, monitor.detector(hz=10.0))
    report = stream.check(level(seen, GRIDS["road"])).now
    said = f"INCONSISTENT, {report.reasons[0]}" if report.inconsistent else "nothing found"
    print(f"{name}: {said} (p = {report.p_value:.2g})")
