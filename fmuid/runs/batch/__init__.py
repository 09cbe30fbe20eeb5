"""Batches: many cases of one study."""
