"""Covariance of estimates whose residuals are coloured: noise models, the sandwich, and how sure its variances are."""
