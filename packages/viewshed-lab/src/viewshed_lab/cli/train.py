"""``viewshed train`` and ``viewshed crossval``: train networks, and choose hyperparameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli._outputs import progress_bar
from viewshed.cli._terminal import raise_if_interrupted

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

    from viewshed_lab.training.log import Step
    from viewshed_lab.training.run import Trained


Config = Annotated[
    str,
    typer.Argument(metavar="CONFIG", help="A TOML file, or a shipped one: road, indoor."),
]

Device = Annotated[str, typer.Option(help="cpu or cuda.")]


def train(
    config: Config,
    out: Annotated[str, typer.Option(help="Folder of this training; a stopped one resumes.")],
    device: Device = "cpu",
    devices: Annotated[int, typer.Option(help="Number of processes or GPUs per machine.")] = 1,
    nodes: Annotated[int, typer.Option(help="Number of machines; run this command on each.")] = 1,
    cache: Annotated[str | None, typer.Option(help="Folder for simulated data; inside --out if not given.")] = None,
) -> None:
    """Train a network. The same command resumes a stopped training.

    Writes network.onnx, history.csv and curves.png to --out.

    Example: viewshed train road --out weights
    """
    from viewshed_lab.training import read_config
    from viewshed_lab.training import train as run

    settings = read_config(config)
    bar = _Bar(settings.name)
    try:
        trained = run(settings, out, device=device, devices=devices, nodes=nodes, on_progress=bar, cache=cache)
    finally:
        bar.close()
    typer.echo(_summary(trained))


def crossval(
    config: Config,
    out: Annotated[str, typer.Option(help="Folder of this cross-validation; a stopped one resumes.")],
    sampler: Annotated[
        str, typer.Option(help="How settings are chosen: grid (all in turn), or optuna (from earlier scores).")
    ] = "grid",
    trials: Annotated[int | None, typer.Option(help="Number of settings to try; all 36 if not given.")] = None,
    folds: Annotated[int, typer.Option(help="Number of folds; no scene is split.")] = 5,
    device: Device = "cpu",
) -> None:
    """Choose width, dropout and learning rate by cross-validation.

    No scene is split between folds. Writes crossval.md, crossval.png and chosen.toml to --out.

    Example: viewshed crossval road --out folds
    """
    from viewshed_lab.training import read_config
    from viewshed_lab.training.cross_validation import PAGE, Search, mean_f1
    from viewshed_lab.training.cross_validation import crossval as run

    settings = read_config(config)
    bar = _Bar(settings.name)
    try:
        validated = run(settings, out, search=Search(sampler, trials, folds), device=device, on_progress=bar.show)
    finally:
        bar.close()
    mean = mean_f1(validated.scores[validated.chosen])
    typer.echo(f"{validated.chosen.name}: mean F1 {mean:.4f} over {folds} folds; read {out}/{PAGE}")


def _summary(trained: Trained) -> str:
    best = trained.best
    return (
        f"{trained.weights}: best epoch {best.number} of {len(trained.history)}, validation F1 {best.f1:.4f}, IoU "
        f"{best.iou:.4f}; {trained.frames_per_s:.1f} frames/s, {trained.network_share:.0%} of the time in the network"
    )


@dataclass(slots=True)
class _Bar:
    """A progress bar that starts with the first report, in the reporting process."""

    name: str
    bar: Progress | None = None
    tasks: dict[str, TaskID] = field(default_factory=dict)

    def __call__(self, step: Step) -> None:
        self.show(self.name, step)

    def show(self, name: str, step: Step) -> None:
        raise_if_interrupted()
        bar = self._started()
        text = f"{name} {step.stage}" if step.epoch == 0 else f"{name} epoch {step.epoch}/{step.epochs} {step.stage}"
        if step.stage not in self.tasks:
            self.tasks[step.stage] = bar.add_task(text, loss="")
        loss = "" if math.isnan(step.loss) else f"loss {step.loss:.4f}"
        bar.update(self.tasks[step.stage], description=text, completed=step.done, total=step.total, loss=loss)

    def close(self) -> None:
        if self.bar is not None:
            self.bar.stop()

    def _started(self) -> Progress:
        if self.bar is None:
            from rich.progress import TextColumn, TimeRemainingColumn

            self.bar = progress_bar(TimeRemainingColumn(), TextColumn("{task.fields[loss]}"))
            self.bar.start()
        return self.bar
