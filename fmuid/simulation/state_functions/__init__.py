"""States that are given: the right-hand side of a model at measured states, and simulations that are corrected."""
