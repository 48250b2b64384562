"""The laboratory of viewshed: simulator, attacks, data sets, training and studies; nothing that a robot needs."""

__version__ = "0.3.0"
