"""Every file format and the archive: scene and rig files in, Parquet and DuckDB out."""
