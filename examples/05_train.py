"""Train a small network on simulated sweeps under attack: seconds here, hours for a useful one."""

import tempfile
from dataclasses import replace
from pathlib import Path

from viewshed.networks.runtime import load_runner
from viewshed_lab._jobs import engine_named
from viewshed_lab.data.archive.storage import Storage
from viewshed_lab.data.presets import preset_named
from viewshed_lab.data.simulated import simulate
from viewshed_lab.training import read_config, train

CELLS, HALF_M = 64, 32.0

with tempfile.TemporaryDirectory() as folder:
    data, out = Path(folder) / "streets", Path(folder) / "training"
    preset = preset_named("nuscenes-small").scaled(60)
    preset = replace(preset, grid_cells=CELLS, grid_half_extent_m=HALF_M, sensors=("vlp16",), scenes=(6, 1))
    archive = simulate(preset, Storage.of(data), engine_named("local", 1))
    print(f"{len(archive)} sweeps in {len(archive.scenes)} scenes")

    config = replace(
        read_config("road"), name="small", data=(str(data),), cells=CELLS, half_extent_m=HALF_M, depth=3, epochs=4,
        frames_per_epoch=0, batch=4, workers=0, precision="32", learning_rate=2e-3,
    )  # fmt: skip
    trained = train(config, out)
    for epoch in trained.history:
        print(f"epoch {epoch.number}: loss {epoch.train_loss:.3f}, validation {epoch.validation_loss:.3f}")
    print(f"{trained.frames_per_s:.0f} frames/s, {trained.network_share:.0%} of the time in the network")

    runner = load_runner(trained.weights)
    sweep = archive.split("test")[0].sweep
    inputs = runner.card.input_of(sweep)[None]
    prob = runner.run(inputs)
    print(f"{trained.weights.name}: input {inputs.shape}, probability {prob.shape}, mean {prob.mean():.2f}")
