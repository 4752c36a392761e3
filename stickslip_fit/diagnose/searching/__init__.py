"""From residuals to causes."""
