"""Estimators: settings frozen, iteration state separate, one loop each."""
