"""Rival ways of naming a hidden cause, on identical logs; results in ../README.md."""
