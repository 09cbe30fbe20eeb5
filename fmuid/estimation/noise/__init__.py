"""Noise models of residuals (docs/method/covariance.md)."""
