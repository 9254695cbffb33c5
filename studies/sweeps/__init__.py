"""Studies: the same episodes under many conditions, described by small TOML files, told in tables, figures and a report."""
