"""Before measuring: bounds, best positions, budgets, requirements."""
