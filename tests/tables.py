"""What the folder of every run has: its page, and its table, as Parquet too where pyarrow is."""

from importlib.util import find_spec

TABLES = {"table.csv"} | ({"table.parquet"} if find_spec("pyarrow") else set())
SHOWN = TABLES | {"report.html", "run.json"}
