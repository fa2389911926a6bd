"""What triangles depend on: budgets, sensitivity, points that are moved."""
