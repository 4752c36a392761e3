"""A diagnosis in words, tables and JSON."""
