"""The plan of the wild study: sets, methods, targets and knowledge."""

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
    """Plan of the study. ``all`` in the TOML stands for all names of a table."""

    FOLDER: ClassVar[str] = "studies/wild/plans"
    WHOLE_TABLES: ClassVar[Mapping[str, Iterable[str]]] = {"methods": ESTIMATORS, "told": GIVEN, "targets": TARGETS}

    name: str  # of the study
    about: str  # one-line description
    sets: tuple[str, ...]  # of ``data.wild.SETS``; ``own`` is the reference, all others together are *other*
    domains: tuple[str, ...]  # ``road``, ``indoor``
    scenes: int  # maximum number of scenes per domain, the first ones; 0 for all
    methods: tuple[str, ...]  # of ``ESTIMATORS``; a network without weights for a grid and target is left out there
    told: tuple[str, ...]  # of ``GIVEN``: data that sweeps have besides their points
    targets: tuple[str, ...]  # of ``TARGETS``
    ladder: bool  # whether the shadow map is also given exact rings, attitude, ground and beams, step by step
    worst: int  # number of the worst scenes per domain that are shown as pictures
    networks: tuple[str, ...]  # files of additional networks, named by their file names

    def __post_init__(self) -> None:
        for key, table in (("sets", SETS), ("domains", DOMAINS), *self.WHOLE_TABLES.items()):
            check_names(key, getattr(self, key), table, once=True)
        self.check_at_least(0, "scenes", "worst")
        if len(set(self.judged)) < len(self.judged):
            raise ValueError(f"networks must have distinct file names, got {', '.join(self.judged)}")

    @property
    def judged(self) -> tuple[str, ...]:
        """Names of the methods in the tables: the methods, and the file names of the networks."""
        return (*self.methods, *(Path(file).stem for file in self.networks))

    @property
    def opens_sealed(self) -> bool:
        """Whether the sets include the sealed one."""
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
