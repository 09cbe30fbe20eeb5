"""The pages with figures: a study, its faults, results, a batch, a study that is to be."""
