"""What the folds of a cross-validation came to, line by line in a file that survives a kill."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from viewshed import journal

FILE = "folds.jsonl"


@dataclass(frozen=True, slots=True)
class FoldScore:
    """The best epoch of one fold.

    Attributes:
        setting: name of what was tried.
        fold: number of the fold, whose scenes were held out.
        f1: of the held-out scenes.
        iou: of the held-out scenes.
        loss: of the held-out scenes.
        epoch: its number.
    """

    setting: str
    fold: int
    f1: float
    iou: float
    loss: float
    epoch: int


@dataclass(frozen=True, slots=True, eq=False)
class FoldStore:
    """Scores in a file: the first line tells what they are of, each other one a finished fold.

    Attributes:
        path: of the file.
        scores: by setting and fold.
    """

    path: Path
    scores: dict[tuple[str, int], FoldScore]

    @classmethod
    def open(cls, folder: Path, about: dict[str, Any]) -> FoldStore:
        """Return the store in a folder, begun if there is none; what a kill left of a last line is cut off.

        Raises:
            ValueError: the folder holds another cross-validation, or the file is damaged.
            OSError: it cannot be read or written.
        """
        path = folder / FILE
        store = cls(path, {})
        if not journal.is_begun(path):
            folder.mkdir(parents=True, exist_ok=True)
            journal.append(path, about)
            return store
        try:
            head, *lines = (json.loads(line) for line in path.read_text(encoding="utf-8").splitlines())
            scores = [FoldScore(**line) for line in lines]
        except (ValueError, TypeError) as error:
            raise ValueError(f"{path} is damaged; delete it, finished folds are read from their folders") from error
        if head != about:
            before, now = head.get("config", {}), about["config"]
            keys = [key for key in {**before, **now} if before.get(key) != now.get(key)]
            other = ", ".join(sorted(keys)) or ", ".join(key for key in about if head.get(key) != about[key])
            raise ValueError(f"{path} is of a cross-validation with other {other}; choose another --out, or delete it")
        store.scores.update({(score.setting, score.fold): score for score in scores})
        return store

    def get(self, setting: str, fold: int) -> FoldScore | None:
        """Return a score, or None where that fold is not finished."""
        return self.scores.get((setting, fold))

    def add(self, score: FoldScore) -> None:
        """Add a score, on the disk when this returns.

        Raises:
            OSError: it cannot be written.
        """
        journal.append(self.path, asdict(score))
        self.scores[score.setting, score.fold] = score
