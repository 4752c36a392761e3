"""The report's figures: one idea per file, data in, Figure out."""
