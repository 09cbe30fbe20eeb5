"""Noise models of residuals (docs/method.md sections 4 and 12)."""
