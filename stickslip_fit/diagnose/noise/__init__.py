"""What is only noise: how well counts repeat, where worse than elsewhere, and which are wildly off."""
