"""Samples of the posterior: the sampler, its chains, and what they tell."""
