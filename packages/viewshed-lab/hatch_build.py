"""The version of the laboratory is that of the robot's package: one number, in ``viewshed/__init__.py``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

SOURCE = Path("..", "viewshed", "src", "viewshed", "__init__.py")


class OneVersion(MetadataHookInterface):
    """Fills in version and dependencies; a source distribution has both in its PKG-INFO already."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Write the version, and the dependencies: the robot's package of that version, which reads and writes bags."""
        found = re.search(
            r'^__version__ = "(.*)"', (Path(self.root) / SOURCE).read_text(encoding="utf-8"), re.MULTILINE
        )
        if found is None:
            raise ValueError(f"{SOURCE} must have a line __version__ = …")
        metadata["version"] = found[1]
        metadata["dependencies"] = [f"viewshed[recordings]=={found[1]}", *self.config["dependencies"]]
