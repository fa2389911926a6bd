"""What is made of predictions and measurements: constants, budgets, sensitivities, fewer triangles."""
