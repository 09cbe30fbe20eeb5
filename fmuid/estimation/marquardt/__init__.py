"""Marquardt's method (1.16), on orthogonal reflections."""
