"""Who is tried: the trained networks and the classical estimators, each as a function of a sweep."""

from __future__ import annotations

from pathlib import Path

from viewshed.estimate import FovEstimator
from viewshed.networks.mcd import mean_and_std
from viewshed.networks.spec import Runner
from viewshed.reproduce.plan import StudyPlan
from viewshed.reproduce.protocols import Model, Setting, generator
from viewshed.reproduce.scoring import Predict, Said
from viewshed.sweep import Sweep

WEIGHTS = "network.onnx"
CHECKPOINT = "network.pt"


def weights_of(folder: Path, model: Model) -> Path:
    """Return where the weights of a model lie."""
    return folder / "models" / model.protocol / model.name / WEIGHTS


def load_runner(path: Path, device: str = "cpu") -> Runner:
    """Return what runs a network: one core, as jobs run beside each other, or a GPU.

    Raises:
        ValueError: the file is damaged or of another version.
        OSError: it cannot be read.
    """
    if device == "cpu":
        from viewshed.networks.engine import OnnxRunner

        return OnnxRunner(path, threads=1)
    from viewshed.networks.unet import TorchRunner, load_weights

    return TorchRunner(*load_weights(path.with_name(CHECKPOINT)), device)


def passes_of(plan: StudyPlan, model: Model) -> int:
    """Return how many passes a model's estimate takes: one with dropout off, or several with dropout on."""
    return plan.passes if model.variant == "mcd" else 1


def network(runner: Runner, setting: Setting, passes: int, seed: int) -> Predict:
    """Return a network as a function of a sweep: one pass with dropout off, or mean and deviation of several.

    The sweep is put on the grid of the setting, wherever the network was trained.

    Args:
        runner: of the network.
        setting: where it is tried.
        passes: 1 for dropout off.
        seed: of the masks, the same for every sweep.
    """
    card = setting.card(runner.card)

    def predict(sweep: Sweep) -> Said:
        inputs = card.input_of(sweep)
        if passes == 1:
            return runner.run(inputs[None], card.shape.no_masks(1))[0], None
        return mean_and_std(runner, inputs, passes, generator(seed, "masks"))

    return predict


def classical(setting: Setting) -> dict[str, Predict]:
    """Return the classical estimators of a setting by name."""
    return {name: _claims(make(setting.grid)) for name, make in setting.classical().items()}


def _claims(estimator: FovEstimator) -> Predict:
    return lambda sweep: (estimator.estimate(sweep).visible_prob, None)
