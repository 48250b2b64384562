"""The laboratory of viewshed: simulator, attacks, data sets, training and studies; nothing that a robot needs."""

from viewshed import __version__

__all__ = ["__version__"]
