"""Drive the joints, hear the end stop, lose nothing."""
