"""What an extension gains on traverses that it has not seen."""
