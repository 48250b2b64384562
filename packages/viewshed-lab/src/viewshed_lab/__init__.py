"""Research tools of viewshed: simulator, attacks, data sets, training and studies. Nothing here runs on a robot."""

from viewshed import __version__

__all__ = ["__version__"]
