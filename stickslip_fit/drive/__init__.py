"""Driving by hand: a wanted velocity of the tip becomes steps, with the tip's uncertainty beside it."""
