"""Archive format: samples in Parquet shards with a manifest, on disk or in an object store."""
