"""What may be at work, as shapes of departures: those of causes, and those that no cause has."""
