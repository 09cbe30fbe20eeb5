"""What is said and drawn of each kind of findings: one module per topic."""
