"""report.html: a data set at a glance, in one file."""
