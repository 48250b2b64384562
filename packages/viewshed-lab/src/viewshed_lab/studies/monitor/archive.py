"""What all evidence reports about a drive, as a file: score, limits and tables come from it without new simulations."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Sequence
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from viewshed._files import write_atomic
from viewshed.monitor.evidence import EVIDENCE
from viewshed.monitor.score import HELD_SWEEPS, held, statistics
from viewshed_lab.studies.records import BENIGN, Case

FOLDER = "drives"

RECORDED = "recorded"
"""Domain and split of drives that were measured, not simulated."""

_CHUNK = 4096

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class DriveEvidence:
    """All evidence of the sweeps of a drive, ten if it was simulated, and of the last five or all in several cases."""

    domain: str  # preset that it is of
    split: str  # train, calibration or test
    number: int  # of the drive
    sensor: str  # that measured
    conditions: Case  # what the drive suffered from its first frame on
    names: tuple[str, ...]  # (E,) of the evidence
    benign: Floats  # (F, E, SECTORS) of the sweeps as they were measured
    unposed: Floats  # (E, SECTORS) of the last sweep, where none of them has a pose
    cases: tuple[Case, ...]  # what was done to the last G of them
    evidence: Floats  # (C, G, E, SECTORS) in these cases
    touched: NDArray[np.bool_]  # (C, G, SECTORS) bool, sectors with a return that an attacker added or removed
    refused: tuple[Case, ...]  # cases that could not be made of this drive

    @property
    def scene(self) -> str:
        """Name of its scene, no other drive has it."""
        return f"{self.domain} {self.split} {self.number}"

    @property
    def file(self) -> str:
        """Name of its file."""
        return f"{self.scene.replace(' ', '-')}.npz"

    def save(self, folder: Path) -> None:
        """Write it to a folder at once or not at all; numbers in half precision. The same drive, the same bytes.

        Raises:
            OSError: the file cannot be written.
        """
        about = {
            "drive": [self.domain, self.split, self.number, self.sensor], "names": list(self.names),
            "conditions": astuple(self.conditions), "cases": [astuple(case) for case in self.cases],
            "refused": [astuple(case) for case in self.refused],
        }  # fmt: skip
        file = io.BytesIO()
        np.savez_compressed(
            file,
            about=np.frombuffer(json.dumps(about).encode(), np.uint8),
            benign=_halved(self.benign),
            unposed=_halved(self.unposed),
            evidence=_halved(self.evidence),
            touched=np.packbits(self.touched, axis=-1),
        )
        write_atomic(folder / self.file, file.getvalue())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Return the drive in a file.

        Raises:
            OSError, ValueError, KeyError: it cannot be read.
        """
        with np.load(path, allow_pickle=False) as file:
            about = json.loads(file["about"].tobytes())
            domain, split, number, sensor = about["drive"]
            touched = np.unpackbits(file["touched"], axis=-1).astype(np.bool_)
            return cls(
                domain, split, number, sensor, Case(*about["conditions"]), tuple(about["names"]), file["benign"],
                file["unposed"], tuple(Case(*case) for case in about["cases"]), file["evidence"], touched,
                tuple(Case(*case) for case in about["refused"]),
            )  # fmt: skip


def over_time_of(names: tuple[str, ...]) -> NDArray[np.bool_]:
    """Return which evidence (E,) compares with earlier sweeps, by name."""
    return np.array([name in EVIDENCE and EVIDENCE[name].over_time for name in names])


def _held(evidence: NDArray[np.float16], over_time: NDArray[np.bool_]) -> NDArray[np.float16]:
    """Return the evidence (F, E, SECTORS) of sweeps in a row, what it says over time carried over as in a stream.

    Sweeps without enough before them abstain over time, and so they stay.
    """
    kept = evidence.copy()
    for frame in range(len(evidence)):
        if not np.isnan(evidence[frame, over_time]).all():
            kept[frame] = held(evidence[max(frame - HELD_SWEEPS + 1, 0) : frame + 1], over_time)
    return kept


def _halved(values: Floats) -> NDArray[np.float16]:
    """Return values in half precision, those beyond its range at its ends."""
    largest = float(np.finfo(np.float16).max)
    return np.clip(values, -largest, largest).astype(np.float16)


@dataclass(frozen=True, slots=True, eq=False)
class SweepTable:
    """Many sweeps of many drives, one row each."""

    names: tuple[str, ...]  # (E,) of the evidence
    # (N, E, SECTORS) float16, over time as :func:`viewshed.monitor.score.held` carries it over
    evidence: NDArray[np.float16]
    touched: NDArray[np.bool_]  # (N, SECTORS) bool
    drive: NDArray[np.int32]  # (N,) which of ``drives`` it is of
    case: NDArray[np.int32]  # (N,) which of ``cases`` it is in; 0 is the drive as it was measured
    frame: NDArray[np.int32]  # (N,) number in the drive
    drives: tuple[DriveAbout, ...]  # without their arrays
    cases: tuple[Case, ...]  # all that occur, ``BENIGN`` first
    unposed: NDArray[np.float16]  # (D, E, SECTORS) float16 of the last benign sweep of each drive, without poses
    # (N, F) of the evidence, what scores judge whole sweeps by; None until :meth:`with_statistics`
    statistics: NDArray[np.float32] | None = None

    @classmethod
    def of(cls, drives: Iterable[DriveEvidence]) -> Self:
        """Return the sweeps of some drives.

        Raises:
            ValueError: there are none, or their evidence differs.
        """
        places: dict[Case, int] = {BENIGN: 0}
        evidence, touched, columns, unposed, about = [], [], [], [], list[DriveAbout]()
        names: tuple[str, ...] = ()
        for number, drive in enumerate(drives):
            if names not in ((), drive.names):
                raise ValueError(f"drives must have the evidence {names}, got {drive.names}; measure them again")
            names = drive.names
            about.append(DriveAbout(drive.domain, drive.split, drive.number, drive.sensor, drive.conditions))
            evidence.append(drive.benign)
            unposed.append(drive.unposed)
            frames = len(drive.benign)
            touched.append(np.zeros((frames, drive.touched.shape[-1]), np.bool_))
            columns += [(number, 0, frame) for frame in range(frames)]
            for case, of_case, of_touched in zip(drive.cases, drive.evidence, drive.touched, strict=True):
                evidence.append(of_case)
                touched.append(of_touched)
                columns += [
                    (number, places.setdefault(case, len(places)), frame)
                    for frame in range(frames - len(of_case), frames)
                ]
        if not about:
            raise ValueError("a table of sweeps needs drives, got none; run the study")
        drive_of, case_of, frame_of = np.array(columns, np.int32).T
        over_time = over_time_of(names)
        return cls(
            names, np.concatenate([_held(of_case, over_time) for of_case in evidence]), np.concatenate(touched),
            drive_of, case_of, frame_of, tuple(about),
            tuple(places), np.stack(unposed),
        )  # fmt: skip

    @classmethod
    def read(cls, folder: Path, *splits: str) -> Self:
        """Return the sweeps of some splits of the drives in a folder, in the order of their names."""
        paths = [path for split in splits for path in sorted((folder / FOLDER).glob(f"*-{split}-*.npz"))]
        return cls.of(DriveEvidence.load(path) for path in paths)

    def with_statistics(self) -> Self:
        """Return the table with its statistics, computed once for all scores."""
        chunks = (self.evidence[start : start + _CHUNK] for start in range(0, len(self.evidence), _CHUNK))
        return replace(self, statistics=np.concatenate([statistics(chunk) for chunk in chunks]))

    def rows(self, mask: NDArray[np.bool_]) -> Self:
        """Return the table of the rows of a mask (N,)."""
        return type(self)(
            self.names, self.evidence[mask], self.touched[mask], self.drive[mask], self.case[mask], self.frame[mask],
            self.drives, self.cases, self.unposed, None if self.statistics is None else self.statistics[mask],
        )  # fmt: skip

    def is_case(self, chosen: Sequence[Case]) -> NDArray[np.bool_]:
        """Return which rows (N,) are in one of some cases."""
        wanted = np.array([case in chosen for case in self.cases])
        return wanted[self.case]


@dataclass(frozen=True, slots=True)
class DriveAbout:
    """What a drive is, without its evidence."""

    domain: str
    split: str
    number: int
    sensor: str
    conditions: Case

    @property
    def scene(self) -> str:
        """Name of its scene, no other drive has it."""
        return f"{self.domain} {self.split} {self.number}"
