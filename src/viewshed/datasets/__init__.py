"""Data sets: samples with truth, in archives of Parquet files."""

from viewshed.datasets.sample import Sample

__all__ = ["Sample"]
