"""Reports of a ring: figures, tables and one-file HTML pages that show a verdict to a person."""
