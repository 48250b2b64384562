"""Options of the estimators that are networks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import typer

from viewshed.cli import options

if TYPE_CHECKING:
    from viewshed.bev import BevGrid
    from viewshed.estimate import FovEstimator

Weights = Annotated[
    str | None,
    typer.Option("--weights", help="Network of unet, mcd and viewnet: a file, or the name of shipped weights."),
]
Passes = Annotated[int | None, typer.Option("--passes", help="Passes of mcd; 20 if not given.")]
Seed = Annotated[int | None, typer.Option("--seed", help="Seed of mcd's dropout masks; 0 if not given.")]
PastSweeps = Annotated[
    int,
    typer.Option(
        "--past", min=0, max=20,
        help="Earlier sweeps of a recording that help viewnet and shadow_map, a second or more apart; 5 do well.",
    ),
]  # fmt: skip
Wary = Annotated[
    bool,
    typer.Option("--wary", help="With --past: claim only what an earlier sweep would have seen as well."),
]
Device = Annotated[str, typer.Option("--device", help="Where unet, mcd and viewnet run: cpu or cuda.")]
Sure = Annotated[
    float | None,
    typer.Option(
        "--sure",
        help="Of unet, mcd and viewnet: claim from this probability, deny up to 1 less it, leave the rest unknown.",
    ),
]


_ENGINES = {"cpu": "onnxruntime", "cuda": "cuda"}
OURS = "viewnet"
"""The method that is taken where none is asked for and weights for it are shipped."""


def _is_shipped(method: str, grid: BevGrid, target: str) -> bool:
    from viewshed.networks.shipped import default_name

    try:
        return bool(default_name(method, grid, target))
    except ValueError:
        return False


@dataclass(frozen=True, slots=True)
class Network:
    """What the options say about the network."""

    weights: str | None = None
    passes: int | None = None
    seed: int | None = None
    sure: float | None = None
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.device not in _ENGINES:
            raise ValueError(f"device must be one of {', '.join(_ENGINES)}, got {self.device!r}")

    def estimator(self, method: str | None, grid: BevGrid, target: str, profile: str = "sound") -> FovEstimator:
        """Return the estimator called ``method``, a network or not; None is the best that there is for a profile.

        That is our network on the grids and for the targets that it is shipped for, else the profile's own.
        """
        from viewshed.estimators.learned import LEARNED, learned

        if method is None and profile == "sound" and _is_shipped(OURS, grid, target):
            method = OURS
        if method in LEARNED:
            engine = _ENGINES[self.device]
            made = learned(method, grid, target, self.weights, self.passes, self.seed or 0, engine=engine)
            return made if self.sure is None else made.when_sure(self.sure)
        if self.sure is not None:
            raise ValueError(f"--sure goes with --method unet, mcd or viewnet, got method {method!r}")
        if self != Network():
            raise ValueError(
                f"--weights, --passes, --seed and --device go with --method unet, mcd or viewnet, got method {method!r}"
            )
        table = options.estimators_of(profile, grid)
        if method is not None and not {method, f"{profile}_{method}"} & set(table):
            raise ValueError(f"method must be one of {', '.join([*table, *LEARNED])}, got {method!r}")
        return options.make_estimator(method, grid, target, profile)

    def remembering(self, estimator: FovEstimator, sweeps: int, wary: bool = False) -> FovEstimator:
        """Return the estimator with so many earlier sweeps to help it, wary or not; as it is for none.

        Raises:
            ValueError: earlier sweeps do not help it.
        """
        from viewshed.estimators.learned import heeds_past
        from viewshed.memory import Memory, Remembering

        if sweeps == 0 and wary:
            raise ValueError("--wary goes with --past 1 or more: it claims what earlier sweeps support")
        if sweeps == 0:
            return estimator
        if heeds_past(estimator):
            return Remembering(estimator, Memory(sweeps), wary)
        raise ValueError("--past goes with --method viewnet or shadow_map, whose estimates earlier sweeps help")

    def threshold(self, given: float | None, estimator: FovEstimator, profile: str) -> float:
        """Return the probability from which a cell counts as visible; a network has its own."""
        from viewshed.estimators.learned import UnetEstimator

        if given is not None and self.sure is not None and given < self.sure:
            raise ValueError(f"--threshold must be at least --sure {self.sure:g}, got {given:g}; leave one of them out")
        own = estimator.claims_from if given is None and isinstance(estimator, UnetEstimator) else given
        return options.parse_threshold(own, profile)
