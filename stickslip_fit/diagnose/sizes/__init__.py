"""How large what was found is."""
