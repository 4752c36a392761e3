"""A log on the bench: rows, laws, how well counts repeat, and all of it linearised."""
