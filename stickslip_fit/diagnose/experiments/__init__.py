"""What traverses yet to be made could tell."""
