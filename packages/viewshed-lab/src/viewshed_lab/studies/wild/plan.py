"""Which sets are run, with which methods, targets and knowledge."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from viewshed.estimators import ESTIMATORS
from viewshed.fov.visibility import TARGETS
from viewshed_lab.data.wild import GIVEN, SEALED, SETS, wild_tables
from viewshed_lab.studies.plan import JobKey, Plan, check_names

DOMAINS = ("road", "indoor")


@dataclass(frozen=True, slots=True)
class WildPlan(Plan):
    """What is run. ``all`` in the TOML stands for a whole table of names."""

    FOLDER: ClassVar[str] = "studies/wild/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {"methods": ESTIMATORS, "told": GIVEN, "targets": TARGETS}

    name: str  # of the study
    about: str  # one line for people
    sets: tuple[str, ...]  # of ``datasets.wild.SETS``; ``own`` is the yardstick, all others together are *other*
    domains: tuple[str, ...]  # ``road``, ``indoor``
    scenes: int  # how many of each domain at most, the first ones; 0 for all
    methods: tuple[str, ...]  # of ``ESTIMATORS``. A network without weights for a grid and target is left out there.
    told: tuple[str, ...]  # of ``GIVEN``: what the sweeps say beside their points
    targets: tuple[str, ...]  # of ``TARGETS``
    ladder: bool  # whether the shadow map is also given the exact ground, returns and rings, one by one
    worst: int  # how many of the worst scenes of each domain are shown as pictures
    networks: tuple[str, ...]  # files of networks that are tried as well, each by the name of its file

    def __post_init__(self) -> None:
        for key, table in (("sets", SETS), ("domains", DOMAINS), *self.WHOLE_TABLES.items()):
            check_names(key, getattr(self, key), table, once=True)
        self.check_at_least(0, "scenes", "worst")
        if len(set(self.judged)) < len(self.judged):
            raise ValueError(f"networks must have file names of their own, got {', '.join(self.judged)}")

    @property
    def judged(self) -> tuple[str, ...]:
        """Names under which estimates stand in the tables: the methods, and the files of the networks."""
        return (*self.methods, *(Path(file).stem for file in self.networks))

    @property
    def opens_sealed(self) -> bool:
        """Whether the sealed set is among the sets."""
        return SEALED in self.sets

    def job_keys(self) -> list[JobKey]:
        """Return set, domain, scene and sweep of each job."""
        return [
            (domain.set_name, domain.name, str(number), str(sweep))
            for set_name in self.sets
            for domain in wild_tables().of_set(set_name)
            if domain.name in self.domains
            for number in range(min(self.scenes or domain.scenes, domain.scenes))
            for sweep in range(domain.sweeps)
        ]
