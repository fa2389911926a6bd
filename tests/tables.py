"""The files that a run's table is written to: Parquet too where pyarrow is."""

from importlib.util import find_spec

TABLES = {"table.csv"} | ({"table.parquet"} if find_spec("pyarrow") else set())
