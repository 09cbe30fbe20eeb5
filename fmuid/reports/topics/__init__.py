"""Messages, tables and charts of findings: one module per topic."""
