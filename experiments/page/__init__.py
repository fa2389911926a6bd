"""The page of a run, report.html: what was asked, its table, charts and pictures, in one file that loads nothing."""
